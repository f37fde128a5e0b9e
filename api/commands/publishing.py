"""`publish`: live values, press events and estimates for the plant's systems."""

from __future__ import annotations

from api.commands.inputs import ConfigFile, config_path
from api.commands.services import log_to_stderr, token_file
from daq.records import InputError
from daq.words import say


def publish(config: ConfigFile = None) -> None:
    """Feed an MQTT broker ([mqtt]) and run an OPC UA server ([opcua]), without end."""
    from daq.process.config import load_config

    path = config_path(config)
    settings = load_config(path)
    try:
        from api.plant.service import publish as run

        if settings.mqtt is not None:
            import paho.mqtt.client  # noqa: F401
        if settings.opcua is not None:
            import asyncua  # noqa: F401
    except ModuleNotFoundError as error:
        raise InputError(say("terminal-needs-package", package=str(error.name))) from error
    log_to_stderr()
    run(settings, token_file(settings.server, path))
