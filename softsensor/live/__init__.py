"""The live sensor: filters side by side, one mixture, its forecast and its validity."""
