"""Vessels to derive one's own from: a shape in a few numbers, and all that follows from it."""
