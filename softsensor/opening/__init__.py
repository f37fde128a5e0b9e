"""When to open: how far the resin has cured, what steam is pent up, and from when every limit holds."""
