"""The press as layers of heat: mesh, compiled steps, the thermal model and its file."""
