"""The only rooms that draw: figures and pages of fits, diagnoses and nights."""
