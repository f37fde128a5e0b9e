"""What the store holds, as the API says it: plain functions, no web framework."""
