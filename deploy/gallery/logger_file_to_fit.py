# %% [markdown]
# # From a logger's file to a fit
#
# A logger wrote its own format: semicolons, decimal commas, German names, a clock. A mapping of a few lines says what
# its columns mean; five lines of Python lead from there to the press's heat transfer coefficients.

# %%
import daq
import softsensor

samples = daq.shared_files() / "samples"
press = softsensor.read_press(daq.shared_files() / "presses/lab.toml")
print("\n".join((samples / "foreign.txt").read_text().splitlines()[:5]))

# %% [markdown]
# The mapping stands beside it. What it says of the panel goes into the run's header.

# %%
run = softsensor.read_run(samples / "foreign.txt", mapping=samples / "foreign.toml")
table = daq.frame_of(run, utc=True)
table.iloc[::30]

# %% [markdown]
# When the press closed and opened is found in the temperatures, to a tenth of a second though the clock shows whole
# seconds.

# %%
daq.find_moments(run, press)

# %%
fitted = softsensor.fit(run, press)
fitted.frame()

# %%
axes = fitted.plot()

# %% [markdown]
# `identifiable` says which coefficients this one run can tell. The same pressing is among the samples as a run file
# with all fourteen sensors: four sensors and a coarse clock found the same contact.

# %%
full = softsensor.fit(samples / "2026-03-04-10.csv", press).frame().loc["2026-03-04-10"]
few = fitted.frame().loc[run.name]
for name in ("h_pp_c", "h_pp_o"):
    assert few.loc[name, "low"] < full.loc[name, "high"] and full.loc[name, "low"] < few.loc[name, "high"], name
full[["value", "low", "high", "identifiable"]]
