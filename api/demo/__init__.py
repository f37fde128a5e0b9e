"""`kerntemp demo`: the whole system on a virtual press."""
