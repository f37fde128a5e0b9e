# %% [markdown]
# # A press of one's own
#
# A press is a file: layers from bottom to top, contacts between them, what is outside, where the sensors are. Here
# the press has plates of 40 mm aluminium instead of the laboratory's 10 mm steel, and its pressings come from the
# virtual press, which solves the same physics by other means.

# %%
import tempfile
from pathlib import Path

import daq
import softsensor
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.physics_pressing import Plates

ALUMINIUM = Plates(thickness=0.040, conductivity=160.0, density=2700.0, heat_capacity=900.0)
plan = Plan(rate_hz=1.0, thickness_mm=16.0, press_time_s=(30.0, 50.0), open_after_s=(30.0, 40.0), plates=ALUMINIUM)
runs = [run for run, _ in make_campaign(11, 3, plan=plan)]

# %% [markdown]
# The laboratory's press file says `thickness_mm = 10.0` and steel; everything else of it fits. A file of one's own is
# best begun as a copy. Unknown keys are refused by name, with the key that was meant.

# %%
laboratory = (daq.shared_files() / "presses/lab.toml").read_text()
own = laboratory.replace("thickness_mm = 10.0", "thickness_mm = 40.0").replace("= 45.0", "= 160.0")
own = (
    own.replace("= 7850.0", "= 2700.0").replace("= 490.0", "= 900.0").replace('name = "lab"', 'name = "aluminium"')
)
folder = Path(tempfile.mkdtemp())
(folder / "aluminium.toml").write_text(own)
(folder / "mistyped.toml").write_text(own.replace("thickness_mm", "thicknes_mm"))
try:
    softsensor.read_press(folder / "mistyped.toml")
except daq.InputError as error:
    print(str(error).replace(f"{folder}/", ""))

# %%
press = softsensor.read_press(folder / "aluminium.toml")
right = softsensor.fit(runs, press)
right.frame()[["value", "low", "high", "identifiable"]]

# %% [markdown]
# With the wrong press file the fit tries to make up for it with wrong contacts, and stays further from the readings.
# `rmse_still_K` leaves out the moments at which readings change fast, where a tenth of a second is some kelvins.

# %%
wrong = softsensor.fit(runs, daq.shared_files() / "presses/lab.toml")
errors = {
    "aluminium": [run.rmse_still_K for run in right.campaign.runs],
    "steel": [run.rmse_still_K for run in wrong.campaign.runs],
}
print({name: [round(value, 2) for value in found] for name, found in errors.items()})
assert all(a < s for a, s in zip(errors["aluminium"], errors["steel"], strict=True))

# %%
axes = right.plot()
