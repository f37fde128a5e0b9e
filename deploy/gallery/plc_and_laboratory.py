# %% [markdown]
# # What the PLC and the laboratory know, joined by time
#
# The logger knows temperatures, the PLC writes a line when something changes, the laboratory weighs samples now and
# then. All three have a clock; `pandas.merge_asof` brings them together.

# %%
from io import StringIO

import pandas as pd

import daq
import softsensor

shared = daq.shared_files()
press = softsensor.read_press(shared / "presses/lab.toml")
run = softsensor.read_run(shared / "samples/foreign.txt", mapping=shared / "samples/foreign.toml")
scans = daq.frame_of(run, utc=True)

plc = pd.read_csv(
    StringIO("""utc,pressure_N_cm2,panel
2026-03-04T07:29:00Z,0,
2026-03-04T07:30:33Z,120,10
2026-03-04T07:30:34Z,350,10
2026-03-04T07:31:57Z,0,10
"""),
    parse_dates=["utc"],
    index_col="utc",
)
laboratory = pd.read_csv(
    StringIO("""taken_utc,moisture_percent,density_kg_m3
2026-03-04T05:50:00Z,8.9,738
2026-03-04T07:10:00Z,7.6,731
2026-03-04T09:05:00Z,8.1,735
"""),
    parse_dates=["taken_utc"],
)

# %% [markdown]
# To every scan the PLC's newest line before it: a value holds until the next one is written.

# %%
plc.index = plc.index.as_unit("ns")
joined = pd.merge_asof(scans, plc[["pressure_N_cm2"]], left_index=True, right_index=True)
joined.attrs.update(scans.attrs)
joined.iloc[10:16]

# %% [markdown]
# To the pressing the laboratory's newest sample before it, but none older than two hours.

# %%
when = pd.DataFrame({"utc": [scans.index[0]]})
laboratory["taken_utc"] = laboratory["taken_utc"].dt.as_unit("ns")
sample = pd.merge_asof(when, laboratory, left_on="utc", right_on="taken_utc", tolerance=pd.Timedelta("2h")).iloc[0]
header = {"panel.moisture_percent": float(sample["moisture_percent"])}
header["panel.density_kg_m3"] = float(sample["density_kg_m3"])
complete = softsensor.read_run(joined, header=header)
{key: value for key, value in complete.header.items() if key.startswith("panel.")}

# %% [markdown]
# Are the clocks the same? The press closes when the pressure rises; the temperatures tell that moment by themselves.
# Here the PLC is some three seconds late, which no join by time would have shown.

# %%
closed = daq.find_moments(complete, press).closed_s
risen = complete.time_s[complete.columns["pressure_N_cm2"] > 100.0][0]
print(f"closed at {closed:.1f} s by the temperatures, pressure at {risen:.0f} s by the PLC's clock")
assert 1.5 < risen - closed < 5.0
fitted = softsensor.fit(complete, press)
fitted

# %%
assert sample["moisture_percent"] == 7.6
assert complete.header["recorded.started_utc"] == scans.index[0]
assert fitted.frame().loc[(complete.name, "h_pp_c"), "identifiable"]
