# %% [markdown]
# # The paper's procedure, and why it gets stuck
#
# The paper solves the layers' differential equations with an adaptive solver and lets an optimiser find the slopes of
# the cost by small differences. An adaptive solver chooses its steps anew for every set of coefficients, so the cost is
# not a smooth curve but a staircase; differences taken across its treads point anywhere. Here both are looked at on
# one pressing, beside a solver with fixed steps that carries its slopes along.

# %%
import matplotlib.pyplot as plt

import daq
import softsensor

shared = daq.shared_files()
press = softsensor.read_press(shared / "presses/lab.toml")
run = softsensor.read_run(shared / "samples/2026-03-04-07.csv")
fitted = softsensor.fit(run, press)
values = fitted.frame().loc[run.name, "value"].to_dict()
measured = [(run, daq.find_moments(run, press), values)]
found = softsensor.reproduce(measured, softsensor.ThermalModel(press))
found.frame()[["converged", "seconds", "solves"]]

# %% [markdown]
# Every search began a factor of up to 3 from the fit; one that ends at the lowest cost that any found has converged. The cost along one coefficient shows why one of them ends early.

# %%
figure, ax = plt.subplots(figsize=(8, 4), layout="constrained")
ax.plot(found.relative, found.adaptive, ".-", label="adaptive solver")
ax.plot(found.relative, found.exact, label="exact solver")
ax.set(xlabel=f"{found.coefficient}, relative to the best", ylabel="cost above its minimum")
ax.set_title("The adaptive solver's cost is a staircase, in which differences get stuck")
legend = ax.legend(frameon=False)
adaptive, exact = found.slope_changes
assert adaptive > 10 * exact

# %% [markdown]
# The way out is not another optimiser but exact slopes: with them, either solver arrives.
