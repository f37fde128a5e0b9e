"""Coefficients from runs: one run, a campaign, what is identifiable, and what to measure."""
