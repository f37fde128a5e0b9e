from pathlib import Path

from daq.process.config import load_config

DEPLOY = Path(__file__).parents[2] / "deploy"


def test_the_example_configuration_is_well_formed_and_wires_all_sixteen_channels():
    config = load_config(DEPLOY / "kerntemp.toml")
    assert len(config.press[0].columns) == 16


def test_each_service_unit_starts_a_command_that_exists():
    from api.cli import app

    commands = {command.name for command in app.registered_commands}
    for unit in (DEPLOY / "systemd").glob("*.service"):
        line = next(x for x in unit.read_text().splitlines() if x.startswith("ExecStart="))
        assert line.split()[1] in commands, unit.name


def test_where_memory_runs_short_a_fit_dies_and_not_the_service_around_it():
    for unit in ("sense", "refit"):
        assert "OOMPolicy=continue" in (DEPLOY / "systemd" / f"kerntemp-{unit}.service").read_text().splitlines()
