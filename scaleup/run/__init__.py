"""The run: planned, locked, blended, kept, published."""
