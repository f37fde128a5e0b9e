"""What the simulation gets wrong: candidates, tests, selection, the extended model."""
