"""Alarms on their way to people: found, kept and delivered."""
