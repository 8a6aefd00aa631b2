"""Geometry `mesh`."""
