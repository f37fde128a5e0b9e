"""A run as the model has it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from daq.given import keys_of
from daq.press.press_file import press_for_run
from daq.records import Run, with_frozen_fields
from softsensor.face.inputs import read_press, run_for
from softsensor.face.models import model_for
from softsensor.face.showing import about, axes_over_time, head_html, lists, shown, table_html, table_text
from softsensor.fitting.simulated_run import Simulated, simulate_run
from softsensor.heat.model import ThermalModel
from softsensor.jobs.model_files import coefficients_of

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from softsensor.face.kinds import AnyModel, AnyPress, AnyRun


@dataclass(frozen=True, repr=False, eq=False)
class Simulation:
    """A run as the model has it, open loop from its platen temperatures. [°C]"""

    run: Run
    """What was simulated: the run as given, or with the settings asked for. [s, °C]"""
    simulated: Simulated
    """Temperatures at every place and through the panel [°C], and how far the readings are off [K]."""

    def frame(self) -> pd.DataFrame:
        """Return the columns of ``simulate --out``, indexed by ``time_s``, the run's header in ``attrs``. [°C]"""
        import pandas as pd

        state = [str(state) for state in self.simulated.state]
        columns = {"state": state, **self.simulated.places, "core_C": self.simulated.core}
        return about(self.run, pd.DataFrame(columns, index=pd.Index(self.simulated.time_s, name="time_s")))

    def plot(self) -> list[Axes]:
        """Draw every place, measured as dots and simulated as lines; return the axes."""
        ax = axes_over_time("figure-dots-and-lines")
        for place, values in self.simulated.places.items():
            (line,) = ax.plot(self.simulated.time_s, values, label=place)
            ax.plot(self.simulated.time_s, self.simulated.measured[place], ".", ms=2, color=line.get_color())
        ax.plot(self.simulated.time_s, self.simulated.core, label="core_C", color="black")
        ax.legend(frameon=False)
        return shown(ax.figure)

    def to_json(self) -> str:
        """Return the table as JSON, a list a column; null where there is no value."""
        return lists(self.frame())

    def __repr__(self) -> str:
        """Show the error at each place, and the first and last rows."""
        return f"{self._head()}\n{table_text(self.frame(), '%.2f')}"

    def _repr_html_(self) -> str:
        return head_html(self._head()) + table_html(self.frame(), "%.2f")

    def _head(self) -> str:
        errors = ", ".join(f"{place} {value:.2f} K" for place, value in self.simulated.rmse.items())
        return f"{self.run.name}: {errors}" if errors else self.run.name


def simulate(
    run: AnyRun,
    press: AnyPress,
    model: AnyModel | Mapping[str, float] | None = None,
    *,
    settings: Mapping[str, float] | None = None,
) -> Simulation:
    """Simulate a run, open loop, from its platen temperatures. [°C]

    Parameters
    ----------
    model
        A model, or coefficients by name [W/m²K]; what it does not name stays at the press file's guess.
    settings
        What if: the same run with other settings, any of ``press_time_s``, ``platen_temperature_C``,
        ``waiting_s``, ``thickness_mm``, ``start_temperature_C``, ``pressure_N_cm2`` and ``moisture_percent``; the
        platens follow the press's movements as they did, and nothing is measured. Another panel: `read_run` with
        its header; other layers: another press file.

    Raises
    ------
    InputError
        For a run, press or model file that cannot be read, words in a column that the press file names, a run
        without a platen's column, a sensor or the panel's data, a coefficient that is unknown or nonphysical, and
        a setting that is unknown here or that no press has.

    Examples
    --------
    >>> from daq import shared_files
    >>> run, press = shared_files() / "samples" / "2026-03-04-07.csv", shared_files() / "presses" / "lab.toml"
    >>> {place: round(rmse, 1) for place, rmse in simulate(run, press).simulated.rmse.items()}
    {'panel.top': 5.5, 'panel.bottom': 4.1, 'panel.middle': 0.5}
    >>> longer = simulate(run, press, settings={"press_time_s": 60.0})
    >>> bool(longer.frame()["core_C"].max() > simulate(run, press).frame()["core_C"].max())
    True
    """
    described = read_press(press)
    loaded, moments = run_for(run, described), None
    wanted = keys_of(settings, "given-no-settings")
    if wanted:
        from softsensor.planning.what_if import changed  # loads slowly, and only who asks what if needs it
        from softsensor.signals.moments import moments_of

        loaded, moments = changed(loaded, described, moments_of(loaded, described), wanted)
    thermal = ThermalModel(described)
    if model is None or isinstance(model, Mapping):
        presses = (described, press_for_run(described, loaded))
        values = thermal.guesses | coefficients_of(keys_of(model, "given-no-model"), presses, "model")
    else:
        content = model_for(model, described, loaded.header)
        thermal, values = content.model(described), {**thermal.guesses, **content.values}
    return Simulation(loaded, with_frozen_fields(simulate_run(loaded, described, thermal, values, known=moments)))
