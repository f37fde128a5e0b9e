"""Measured runs of other laboratories, each set by the names of its files: data that come later change no test."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("KERNTEMP_DATA", ROOT.parent / "shared" / "data"))

PRESS_RIG = tuple(
    f"press_rig/{name}.dat"
    for name in (
        "230918-1025-smooth", "230918-1108-med", "230918-1117-med2",
        "230918-1127-rough", "230929-med", "230929-smooth",
    )
)  # fmt: skip
INERT_BOARD = ("inert_board/Black-Insulation_q50_Temp.csv",)
COPPER_DISC = ("inert_board/Black-Copper_q50_Temp.csv",)
PMMA_25_KW = tuple(f"inert_board/MaCFP-PMMA_Gasification_q25_Temp_R{n}.csv" for n in (1, 2, 3))
PINE_SLABS = (
    *(f"pine_gasification/TIFP+UCT_Wood_Gasification_30kW_hor_parallel_R{n}.csv" for n in (1, 2, 4)),
    *(f"pine_gasification/TIFP+UCT_Wood_Gasification_30kW_hor_perpendicular_R{n}.csv" for n in (1, 2, 3)),
)
MOIST_DISCS_40_KW = tuple(f"pine_gasification/FSRI_Wood_CAPA_N2_40kW_R{n}.csv" for n in (1, 2))
MOIST_DISCS = (*MOIST_DISCS_40_KW, *(f"pine_gasification/FSRI_Wood_CAPA_N2_60kW_R{n}.csv" for n in (1, 2)))
DRY_DISCS = tuple(f"pine_gasification/UMD_Wood_CAPA_N2_{kw}kW_R{n}.csv" for kw in (30, 50) for n in (1, 2, 3))
PINE_DEPTH = tuple(f"pine_depth/FPL_Wood_Cone_50kW_hor_R{n}.csv" for n in (4, 5))
PMMA_50_KW = tuple(f"pmma_dry/MaCFP-PMMA_Gasification_q50_Temp_R{n}.csv" for n in (1, 2, 3))


def measured(names):
    """Return the paths of these files, or skip the test where they are not at hand."""
    paths = [DATA / name for name in names]
    missing = [path.name for path in paths if not path.is_file()]
    if missing:
        pytest.skip(
            f"measured files are not here: {', '.join(missing)}; set KERNTEMP_DATA to the folder of the sets"
        )
    return paths
