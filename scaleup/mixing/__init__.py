"""Mixing: the march of a backend through a flow, and what backends are made of."""
