"""What an advice can be asked for and what is taken unless asked; without imports, the command line reads it."""

# By hand, 2026-11: a second is the least that a press's log shows, and longer no panel lies in a press.

WAITING_S = (1.0, 600.0)
"""From laying the panel in to closing. [s] By hand."""
OPEN_S = (1.0, 3600.0)
"""How long the press is open between two panels. [s] By hand."""
USUAL_OPEN_S = 30.0
"""The same unless asked otherwise; of the wait that is `daq.records.USUAL_WAIT_S`. [s] By hand."""
PRICE = (0.0, 1e6)
"""Of a kWh. [€] By hand."""
