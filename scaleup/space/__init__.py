"""Space: the grid, its cut cells, their share among ranks, and the flow that is given on it."""
