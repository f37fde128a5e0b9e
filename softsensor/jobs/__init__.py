"""What runs beside the store and the clock: the live service, the refit, the night."""
