"""Which pressings are worth most: what each would settle, worked out before it is pressed.

Floors: `plan` (the search) on `open_points` (what is open, and what a pressing settles of it) on `design_point`
(a pressing that was not pressed, as a linear problem) on `information` (its algebra) and `program` (its settings).
"""
