"""Kerntemp in the plant's systems: MQTT and OPC UA, both fed from the store by `kerntemp publish`."""
