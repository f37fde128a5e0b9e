# %% [markdown]
# # Live from a running store
#
# While a press runs, its recorder writes every scan into the store. Anybody may read along: this notebook follows the
# run that is being recorded and feeds a live sensor of its own by hand, without touching the services.

# %%
import tempfile
import threading
import time
from pathlib import Path

import daq
import softsensor

shared = daq.shared_files()
press = softsensor.read_press(shared / "presses/lab.toml")
url = Path(tempfile.mkdtemp()) / "kerntemp.sqlite"

# %% [markdown]
# Here a thread stands in for the recorder: it plays a sample pressing into the store, a good deal faster than real
# time. With a press at hand, leave this cell out and give the address of its store.

# %%
played = softsensor.read_run(shared / "samples/2026-03-04-05.csv", header={"run": "now"})
recorder = threading.Thread(target=daq.play, args=(played, url, press.name), kwargs={"scans": 5, "pause_s": 0.02})
recorder.start()

# %% [markdown]
# The store as tables: which run is open, and what has been read of it so far. Each new scan goes to the sensor, which
# says at once what the core is doing; row i rests on nothing later than scan i.

# %%
live = []
while not url.exists():
    time.sleep(0.02)
with daq.open_store(url) as store:
    while store.runs().empty:
        time.sleep(0.02)
    name = store.runs().index[0]
    sensor = softsensor.LiveSensor(press, store.samples(name).attrs)
    done = False
    while not done:
        done = store.runs().loc[name, "status"] != "open"
        for time_s, row in store.samples(name).iloc[len(live) :].iterrows():
            live.append(sensor.update(time_s, row.to_dict()))
        time.sleep(0.05)
recorder.join()
newest = live[-1]
print(f"{newest.state} after {newest.time_s:.0f} s: core {newest.core_C:.1f} °C")

# %%
import matplotlib.pyplot as plt

figure, ax = plt.subplots(figsize=(8, 4), layout="constrained")
times = [e.time_s for e in live]
ax.fill_between(
    times, [e.core_low_C for e in live], [e.core_high_C for e in live], alpha=0.25, lw=0, label="95 % band"
)
ax.plot(times, [e.core_C for e in live], label="core, as said live")
ax.set(xlabel="time of the run [s]", ylabel="temperature [°C]", title="The core while the recorder was writing")
legend = ax.legend(frameon=False)

# %% [markdown]
# Replayed afterwards, the same pressing gives the same answers: live and replay are one code.

# %%
again = softsensor.predict(played, press).frame()
assert len(again) == len(live)
assert max(abs(again["core_C"].to_numpy() - [e.core_C for e in live])) < 1e-6
