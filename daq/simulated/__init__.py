"""The virtual press and the simulated loggers that speak for it."""
