"""The commands of `kerntemp`. They import what they need when they run: `--help` answers at once."""
