"""The press file, and the moments at which the press closes and opens."""
