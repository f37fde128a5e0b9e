"""A simulated device a user can start by hand, wired by the table it prints."""

from __future__ import annotations

import threading
import tomllib

import pytest

from daq.drivers import LoggerSettings, open_logger
from daq.records import InputError, Quality
from daq.simulated.devices_serve import main
from tests.patience import wait_until


@pytest.mark.parametrize(
    "arguments",
    [
        ["adam-4118-ascii", "--address", "5", "--open", "2"],
        ["generic", "--open", "2"],
        ["m-7019r", "--transport", "rtu_over_tcp", "--open", "2"],
    ],
)
def test_the_printed_table_reads_the_device(arguments, capsys):
    stop = threading.Event()
    server = threading.Thread(target=main, args=(arguments, stop))
    server.start()
    try:
        printed = []
        wait_until(lambda: printed.append(capsys.readouterr().out) or "channels" in "".join(printed))
        (table,) = tomllib.loads("".join(printed))["press"]["logger"]
        logger = open_logger(LoggerSettings(**table))
        reading = logger.read()
        logger.close()
    finally:
        stop.set()
        server.join()
    assert reading.qualities[2] is Quality.OPEN
    assert reading.values[7] == pytest.approx(21.0 + 2.1, abs=0.3)


def test_an_input_the_device_lacks_is_refused():
    with pytest.raises(InputError, match="inputs 0 to 7"):
        main(["adam-4118", "--open", "8"], threading.Event())
