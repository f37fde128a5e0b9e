# %% [markdown]
# # From another logger's files to a named cause
#
# Eight pressings of a line lie in a folder as its logger wrote them: tabs, degrees Fahrenheit, a clock without a date,
# the thickness in the file's name. [A mapping](../samples/line2.toml) says so once. Five lines lead from there to what
# the simulation of that press gets wrong, and why; nothing but these files is told to them.

# %%
import daq
import softsensor

shared = daq.shared_files()
files = sorted((shared / "samples").glob("line2_*.txt"))
runs = [softsensor.read_run(file, mapping=shared / "samples/line2.toml") for file in files]
found = softsensor.diagnose(runs, shared / "presses/lab.toml")
print(found)

# %% [markdown]
# `ratio` is the upper contact in units of the lower one while the press is closed. It is surely below 1: the upper face
# takes up heat less well, as beneath a worn plate. The run that the plain model describes worst, with and without it:

# %%
axes = found.plot()

# %% [markdown]
# These pressings are of a virtual press in which the upper contact was made 0.7 of the lower one; see
# [make_samples.py](../samples/make_samples.py). So it can be checked:

# %%
ratio = found.frame().loc[("contact_asymmetry", "ratio")]
assert found.verdict == "named" and list(found.frame().index) == [("contact_asymmetry", "ratio")]
assert ratio["low"] < 0.7 < ratio["high"] < 1.0
low, value, high = ratio["low"], ratio["value"], ratio["high"]
print(f"the upper contact is {value:.2f} of the lower one, 95 % between {low:.2f} and {high:.2f}")
