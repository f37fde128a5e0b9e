"""What may be given for a run, a press and a model: for type checkers and the reference; nothing else loads it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

import pandas as pd

from daq.press.press_file import Press
from daq.records import Run
from softsensor.face.diagnosing import DiagnosisResult
from softsensor.face.fitting import FitResult
from softsensor.heat.model_file import ModelFile

AnyRun: TypeAlias = Run | pd.DataFrame | Path | str
AnyPress: TypeAlias = Press | Path | str
AnyScan: TypeAlias = Mapping[str, float | None] | pd.Series
Until: TypeAlias = float | str | Sequence[float | str]
AnyModel: TypeAlias = ModelFile | FitResult | DiagnosisResult | Path | str
