"""The thermal model of a press, its fit, its diagnosis and the live sensor.

What ``__all__`` lists is stable, typed and documented; everything else may change. Nothing is imported
before it is used.

>>> import softsensor
>>> run = softsensor.read_run("deploy/samples/2026-03-04-01.csv")
>>> simulated = softsensor.simulate(run, "deploy/presses/lab.toml")
>>> list(simulated.frame().columns)
['state', 'panel.top', 'panel.bottom', 'core_C']
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from softsensor.effects import add_effect as add_effect
    from softsensor.face import AdviceResult as AdviceResult
    from softsensor.face import DiagnosisResult as DiagnosisResult
    from softsensor.face import FitResult as FitResult
    from softsensor.face import PlanResult as PlanResult
    from softsensor.face import Prediction as Prediction
    from softsensor.face import Simulation as Simulation
    from softsensor.face import advise as advise
    from softsensor.face import diagnose as diagnose
    from softsensor.face import fit as fit
    from softsensor.face import plan as plan
    from softsensor.face import predict as predict
    from softsensor.face import read_model as read_model
    from softsensor.face import read_press as read_press
    from softsensor.face import read_run as read_run
    from softsensor.face import simulate as simulate
    from softsensor.live.sensor import Estimate as Estimate
    from softsensor.live.sensor import LiveSensor as LiveSensor

__all__ = [
    "AdviceResult",
    "DiagnosisResult",
    "Estimate",
    "FitResult",
    "LiveSensor",
    "PlanResult",
    "Prediction",
    "Simulation",
    "add_effect",
    "advise",
    "diagnose",
    "fit",
    "plan",
    "predict",
    "read_model",
    "read_press",
    "read_run",
    "simulate",
]
_HOMES = {
    "Estimate": "softsensor.live.sensor",
    "LiveSensor": "softsensor.live.sensor",
    "add_effect": "softsensor.effects",
}


def __getattr__(name: str) -> Any:
    """Load a public name on first use (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module 'softsensor' has no attribute {name!r}; it has {', '.join(__all__)}")
    found = globals()[name] = getattr(import_module(_HOMES.get(name, "softsensor.face")), name)
    return found


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
