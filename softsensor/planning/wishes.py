"""Between which numbers an advice can be asked for; without imports, for the command line's help reads them."""

# By hand, 2026-11: a second is the least that a press's log shows, and longer no panel lies in a press.

WAITING_S = (1.0, 600.0)
"""From laying the panel in to closing. [s] By hand."""
OPEN_S = (1.0, 3600.0)
"""How long the press is open between two panels. [s] By hand."""
PRICE = (0.0, 1e6)
"""Of a kWh. [€] By hand."""
