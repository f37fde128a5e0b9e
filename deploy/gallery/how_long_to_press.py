# %% [markdown]
# # How long must I press?
#
# Until the core is warm enough, and with a margin for what is not known exactly. The pressings so far give the
# model, its covariance gives the margin: the press time is worked out for a hundred sets of parameters that the
# pressings allow, and the time that suffices for 95 of them is the answer.

# %%
import matplotlib.pyplot as plt
import numpy as np

import daq
import softsensor

TARGET_C = 95.0
"""The core must reach this before the press opens. [°C]"""
CLOSED_S = 10.0

shared = daq.shared_files()
press = softsensor.read_press(shared / "presses/lab.toml")
runs = [softsensor.read_run(path) for path in sorted((shared / "samples").glob("2026-*.csv"))[:4]]
model = softsensor.diagnose(runs, press, effects=["moisture_evaporation"]).model()
thermal = model.model(press)

# %% [markdown]
# A pressing that has not been made: a panel at 20 °C between platens at 200 °C, closed after 10 s for six minutes.


# %%
def case_of(thickness_mm):
    """Return it for the solver."""
    time_s = np.arange(0.0, 380.0, 1.0)
    header = {"panel.material": "MDF", "panel.thickness_mm": thickness_mm, "panel.initial_temperature_C": 20.0}
    run = daq.Run(
        "asked", header, time_s, {name: np.full(len(time_s), 200.0) for name in ("platen_top", "platen_bottom")}
    )
    return thermal.prepare(run, daq.Moments(inserted_s=0.0, closed_s=CLOSED_S, opened_s=CLOSED_S + 360.0))


def draws(number):
    """Return sets of parameters as the pressings allow them: coefficients log-normal, effects' parameters normal."""
    rng = np.random.default_rng(1)
    middle = [np.log(model.values[n]) if n in model.coefficients else model.values[n] for n in model.names]
    for z in rng.multivariate_normal(middle, model.covariance, number):
        pairs = zip(model.names, z, strict=True)
        drawn = {n: float(np.exp(v)) if n in model.coefficients else max(float(v), 0.0) for n, v in pairs}
        yield {**model.values, **drawn}


def time_needed(case, values):
    """Return how long the press must stay closed. [s]"""
    core = thermal.solve(case, values).core
    warm = np.flatnonzero(core >= TARGET_C)
    return float(case.run.time_s[warm[0]]) - CLOSED_S if len(warm) else np.inf


# %%
needed = {d: np.sort([time_needed(case_of(d), values) for values in draws(100)]) for d in (8.0, 10.0, 12.0)}
for thickness, times in needed.items():
    print(
        f"{thickness:g} mm: {np.quantile(times, 0.5):.0f} s is as likely enough as not, {times[94]:.0f} s at 95 %"
    )

# %%
figure, ax = plt.subplots(figsize=(8, 4), layout="constrained")
for thickness, times in needed.items():
    ax.step(times, np.arange(1, 101), where="post", label=f"{thickness:g} mm")
ax.axhline(95, color="0.6", linestyle=":")
ax.set(xlabel="press time [s]", ylabel=f"chance that the core reached {TARGET_C:g} °C [%]")
ax.set_title("The margin for what is not known grows with the thickness")
legend = ax.legend(frameon=False)

# %%
assert needed[8.0][94] < needed[10.0][94] < needed[12.0][94] < 370.0
assert all(times[94] > np.median(times) for times in needed.values())
