"""The thermal model of a press, its fit, its diagnosis and the live sensor.

What ``__all__`` lists is stable, typed and documented; everything else may change. Nothing is imported
before it is used.

>>> import daq, softsensor
>>> shared = daq.shared_files()
>>> run = softsensor.read_run(shared / "samples" / "2026-03-04-01.csv")
>>> simulated = softsensor.simulate(run, shared / "presses" / "lab.toml")
>>> list(simulated.frame().columns)
['state', 'panel.top', 'panel.bottom', 'core_C']
"""

from importlib import import_module
from time import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daq.press.press_file import Press as Press
    from daq.press.resin_file import Resin as Resin
    from softsensor.diagnosis.finding import Diagnosis as Diagnosis
    from softsensor.diagnosis.rehearsal import Hidden as Hidden
    from softsensor.diagnosis.rehearsal import Rate as Rate
    from softsensor.diagnosis.rehearsal import Rehearsal as Rehearsal
    from softsensor.diagnosis.rehearsal import RehearsedCause as RehearsedCause
    from softsensor.effects import Conversion as Conversion
    from softsensor.effects import Effect as Effect
    from softsensor.effects import Live as Live
    from softsensor.effects import Need as Need
    from softsensor.effects import Role as Role
    from softsensor.effects import Scene as Scene
    from softsensor.effects import Source as Source
    from softsensor.effects import Terms as Terms
    from softsensor.effects import add_effect as add_effect
    from softsensor.effects import find_effect as find_effect
    from softsensor.effects import on_panel as on_panel
    from softsensor.effects.parameters import Parameter as Parameter
    from softsensor.face.advising import AdviceResult as AdviceResult
    from softsensor.face.advising import advise as advise
    from softsensor.face.diagnosing import DiagnosisResult as DiagnosisResult
    from softsensor.face.diagnosing import diagnose as diagnose
    from softsensor.face.feeding import LiveSensor as LiveSensor
    from softsensor.face.fitting import FitResult as FitResult
    from softsensor.face.fitting import fit as fit
    from softsensor.face.inputs import read_press as read_press
    from softsensor.face.inputs import read_run as read_run
    from softsensor.face.learning import SteamLimit as SteamLimit
    from softsensor.face.learning import learn_steam_limit as learn_steam_limit
    from softsensor.face.models import read_model as read_model
    from softsensor.face.planning import PlanResult as PlanResult
    from softsensor.face.planning import plan as plan
    from softsensor.face.predicting import Prediction as Prediction
    from softsensor.face.predicting import predict as predict
    from softsensor.face.rehearsing import RehearsalResult as RehearsalResult
    from softsensor.face.rehearsing import rehearse as rehearse
    from softsensor.face.reproducing import Reproduction as Reproduction
    from softsensor.face.reproducing import reproduce as reproduce
    from softsensor.face.simulating import Simulation as Simulation
    from softsensor.face.simulating import simulate as simulate
    from softsensor.fitting.campaign import CampaignFit as CampaignFit
    from softsensor.fitting.paper.procedures import Combination as Combination
    from softsensor.fitting.result import RunFit as RunFit
    from softsensor.fitting.simulated_run import Simulated as Simulated
    from softsensor.heat.model import ThermalModel as ThermalModel
    from softsensor.heat.model_file import FittedValue as FittedValue
    from softsensor.heat.model_file import ModelFile as ModelFile
    from softsensor.live.forecast import Forecast as Forecast
    from softsensor.live.inside import Inside as Inside
    from softsensor.live.leaving import Leave as Leave
    from softsensor.live.replay import Replay as Replay
    from softsensor.live.sensor import Estimate as Estimate
    from softsensor.live.validity import Invalid as Invalid
    from softsensor.live.validity import InvalidReason as InvalidReason
    from softsensor.opening.limits import Opening as Opening
    from softsensor.planning.advise import ProgrammeAdvice as ProgrammeAdvice
    from softsensor.planning.advise import Saving as Saving
    from softsensor.planning.advise import TriedProgramme as TriedProgramme
    from softsensor.planning.made_up import Programme as Programme
    from softsensor.planning.open_points import Prospect as Prospect
    from softsensor.planning.plan import PlannedPressing as PlannedPressing
    from softsensor.planning.plan import PointAdvice as PointAdvice
    from softsensor.planning.plan import PressingPlan as PressingPlan

IMPORTED_S = time()
"""When this process began to import the package; see `daq.compiled`. [s]"""

__all__ = [
    "AdviceResult",
    "CampaignFit",
    "Combination",
    "Conversion",
    "Diagnosis",
    "DiagnosisResult",
    "Effect",
    "Estimate",
    "FitResult",
    "FittedValue",
    "Forecast",
    "Hidden",
    "Inside",
    "Invalid",
    "InvalidReason",
    "Leave",
    "Live",
    "LiveSensor",
    "ModelFile",
    "Need",
    "Opening",
    "Parameter",
    "PlanResult",
    "PlannedPressing",
    "PointAdvice",
    "Prediction",
    "Press",
    "PressingPlan",
    "Programme",
    "ProgrammeAdvice",
    "Prospect",
    "Rate",
    "Rehearsal",
    "RehearsalResult",
    "RehearsedCause",
    "Replay",
    "Reproduction",
    "Resin",
    "Role",
    "RunFit",
    "Saving",
    "Scene",
    "Simulated",
    "Simulation",
    "Source",
    "SteamLimit",
    "Terms",
    "ThermalModel",
    "TriedProgramme",
    "add_effect",
    "advise",
    "diagnose",
    "find_effect",
    "fit",
    "learn_steam_limit",
    "on_panel",
    "plan",
    "predict",
    "read_model",
    "read_press",
    "read_run",
    "rehearse",
    "reproduce",
    "simulate",
]
_HOMES = {
    "AdviceResult": "softsensor.face.advising",
    "CampaignFit": "softsensor.fitting.campaign",
    "Combination": "softsensor.fitting.paper.procedures",
    "Conversion": "softsensor.effects",
    "Diagnosis": "softsensor.diagnosis.finding",
    "DiagnosisResult": "softsensor.face.diagnosing",
    "Effect": "softsensor.effects",
    "Estimate": "softsensor.live.sensor",
    "FitResult": "softsensor.face.fitting",
    "FittedValue": "softsensor.heat.model_file",
    "Forecast": "softsensor.live.forecast",
    "Hidden": "softsensor.diagnosis.rehearsal",
    "Inside": "softsensor.live.inside",
    "Invalid": "softsensor.live.validity",
    "InvalidReason": "softsensor.live.validity",
    "Leave": "softsensor.live.leaving",
    "Live": "softsensor.effects",
    "LiveSensor": "softsensor.face.feeding",
    "ModelFile": "softsensor.heat.model_file",
    "Need": "softsensor.effects",
    "Opening": "softsensor.opening.limits",
    "Parameter": "softsensor.effects.parameters",
    "PlanResult": "softsensor.face.planning",
    "PlannedPressing": "softsensor.planning.plan",
    "PointAdvice": "softsensor.planning.plan",
    "Prediction": "softsensor.face.predicting",
    "Press": "daq.press.press_file",
    "PressingPlan": "softsensor.planning.plan",
    "Programme": "softsensor.planning.made_up",
    "ProgrammeAdvice": "softsensor.planning.advise",
    "Prospect": "softsensor.planning.open_points",
    "Rate": "softsensor.diagnosis.rehearsal",
    "Rehearsal": "softsensor.diagnosis.rehearsal",
    "RehearsalResult": "softsensor.face.rehearsing",
    "RehearsedCause": "softsensor.diagnosis.rehearsal",
    "Replay": "softsensor.live.replay",
    "Reproduction": "softsensor.face.reproducing",
    "Resin": "daq.press.resin_file",
    "Role": "softsensor.effects",
    "RunFit": "softsensor.fitting.result",
    "Saving": "softsensor.planning.advise",
    "Scene": "softsensor.effects",
    "Simulated": "softsensor.fitting.simulated_run",
    "Simulation": "softsensor.face.simulating",
    "Source": "softsensor.effects",
    "SteamLimit": "softsensor.face.learning",
    "Terms": "softsensor.effects",
    "ThermalModel": "softsensor.heat.model",
    "TriedProgramme": "softsensor.planning.advise",
    "add_effect": "softsensor.effects",
    "advise": "softsensor.face.advising",
    "diagnose": "softsensor.face.diagnosing",
    "find_effect": "softsensor.effects",
    "fit": "softsensor.face.fitting",
    "learn_steam_limit": "softsensor.face.learning",
    "on_panel": "softsensor.effects",
    "plan": "softsensor.face.planning",
    "predict": "softsensor.face.predicting",
    "read_model": "softsensor.face.models",
    "read_press": "softsensor.face.inputs",
    "read_run": "softsensor.face.inputs",
    "rehearse": "softsensor.face.rehearsing",
    "reproduce": "softsensor.face.reproducing",
    "simulate": "softsensor.face.simulating",
}


if not TYPE_CHECKING:  # checkers read the imports above, and see a misspelt name

    def __getattr__(name: str) -> Any:
        """Load a public name on first use (PEP 562)."""
        if name not in __all__:
            raise AttributeError(f"module 'softsensor' has no attribute {name!r}; it has {', '.join(__all__)}")
        found = globals()[name] = getattr(import_module(_HOMES[name]), name)
        return found


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
