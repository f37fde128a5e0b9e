"""Curves of a diagnosis as a night keeps them: a panel that warms towards its platen, and two models of it."""

import math

TIME = [float(t) for t in range(0, 90, 3)]


def _warming(seconds: float, lag: float) -> list[float]:
    return [round(200.0 - 180.0 * math.exp(-max(t - lag, 0.0) / seconds), 3) for t in TIME]


def _place(name: str) -> dict:
    plain, extended = _warming(20.0, 0.0), _warming(24.0, 0.0)
    measured = [round(value + 0.2 * math.sin(i), 3) for i, value in enumerate(extended)]
    return {
        "place": name,
        "measured_C": measured,
        "low_C": [v - 1.0 for v in measured],
        "high_C": [v + 1.0 for v in measured],
        "plain_C": plain,
        "extended_C": extended,
        "plain_residual_K": [round(m - p, 3) for m, p in zip(measured, plain, strict=True)],
        "extended_residual_K": [round(m - p, 3) for m, p in zip(measured, extended, strict=True)],
    }


PLACES = [_place("panel.top"), _place("panel.bottom")]
CURVES = {
    "run": "campaign-1",
    "closed_s": 6.0,
    "opened_s": 60.0,
    "time_s": TIME,
    "rmse_K": [6.1, 0.14],
    "causes": ["moisture_evaporation"],
    "places": PLACES,
    "core": {"measured_C": {}, "plain_C": _warming(60.0, 10.0), "extended_C": _warming(70.0, 10.0)},
    "marks": [],
    "campaign": {
        "closes": True,
        "runs": ["campaign-1", "campaign-2"],
        "since_s": TIME,
        "places": [
            {
                "place": p["place"],
                "plain_K": [p["plain_residual_K"], p["plain_residual_K"]],
                "extended_K": [p["extended_residual_K"], p["extended_residual_K"]],
            }
            for p in PLACES
        ],
    },
    "votes": [{"cause": "moisture_evaporation", "gains": [410.0, 385.0]}],
}
