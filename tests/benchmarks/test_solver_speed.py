"""Speed of the thermal model beside general solvers, on one press cycle, at stated errors.

Five layers, about 120 graded cells, 300 s at 10 Hz. Times are the least processor time of several calls.
All methods solve the same mesh; errors are the largest, over rows and places, against the exact solver,
from 0.25 s after a ramp. Our implicit steps are 0.05 s around a switch and grow to 2 s. "Equal accuracy" is
the loosest tolerance whose error is at most 0.05 K (or that of the implicit solver, where that is larger).
"""

import time
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.sparse import diags

from daq.press.press_file import parse_press
from daq.records import Moments, Run
from softsensor.heat import exact
from softsensor.heat import step_terms as kernels_terms
from softsensor.heat.batch import solve_many
from softsensor.heat.model import ThermalModel

pytestmark = [pytest.mark.benchmark, pytest.mark.timeout(1800)]

MOMENTS = Moments(inserted_s=2.0, closed_s=60.0, opened_s=180.0, removed_s=295.0, ramp_s=0.4)
GRID = {"fineness": 1.2, "max_step_s": 2.4, "switch_step_s": 0.06, "growth": 1.15}
VALUES = {
    "h_b": 2000.0,
    "h_p_o": 800.0,
    "h_p_c": 900.0,
    "h_pp_o": 40.0,
    "h_pp_c": 700.0,
    "h_wa": 12.0,
    "h_ap": 10.0,
}
STEEL = "conductivity_W_mK = 45.0\ndensity_kg_m3 = 7850.0\nheat_capacity_J_kgK = 490.0"
PAD = "conductivity_W_mK = 0.4\ndensity_kg_m3 = 1500.0\nheat_capacity_J_kgK = 1000.0"
PRESS = f"""
[[layer]]
name = "pad_bottom"
thickness_mm = 1.5
{PAD}
[[layer]]
name = "plate_bottom"
thickness_mm = 10.0
{STEEL}
[[layer]]
name = "panel"
from_run = true
[[layer]]
name = "plate_top"
thickness_mm = 10.0
{STEEL}
[[layer]]
name = "pad_top"
thickness_mm = 1.5
{PAD}
[boundary.bottom]
kind = "measured"
column = "platen_bottom"
[boundary.top]
kind = "measured"
column = "platen_top"
[[contact]]
between = ["boundary.bottom", "pad_bottom"]
closed = "h_b"
[[contact]]
between = ["pad_bottom", "plate_bottom"]
open = "h_p_o"
closed = "h_p_c"
[[contact]]
between = ["plate_bottom", "panel"]
open = "h_pp_o"
closed = "h_pp_c"
[[contact]]
between = ["panel", "plate_top"]
open = ["h_wa", "h_ap"]
closed = "h_pp_c"
[[contact]]
between = ["plate_top", "pad_top"]
open = "h_p_o"
closed = "h_p_c"
[[contact]]
between = ["pad_top", "boundary.top"]
closed = "h_b"
[[sensor]]
columns = ["top_1"]
at = "panel.top"
[[sensor]]
columns = ["bottom_1"]
at = "panel.bottom"
"""


def make_run(seed: int, noise: float, end: float = 300.0) -> Run:
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, end + 0.05, 0.1)
    columns = {
        "platen_top": 200.0 + 2.0 * np.sin(t / 15.0) + noise * rng.normal(size=len(t)),
        "platen_bottom": 198.0 + 2.0 * np.cos(t / 20.0) + noise * rng.normal(size=len(t)),
        "top_1": np.full(len(t), np.nan),
        "bottom_1": np.full(len(t), np.nan),
    }
    header = {"panel.material": "MDF", "panel.thickness_mm": 16.0, "panel.initial_temperature_C": 21.0}
    return Run(f"run {seed}", header, t, columns)


def least_ms(call, repeats: int = 15) -> float:
    best = np.inf
    for _ in range(repeats):
        start = time.thread_time()
        call()
        best = min(best, time.thread_time() - start)
    return best * 1e3


def settled(t):
    keep = np.ones(len(t), dtype=bool)
    for moment in (MOMENTS.inserted_s, MOMENTS.closed_s, MOMENTS.opened_s, MOMENTS.removed_s):
        keep &= (t < moment - 0.25) | (t > moment + 0.45)
    return keep


class MethodOfLines:
    """The same cells as a right-hand side for general solvers; coefficients tabulated through the ramps."""

    def __init__(self, model, case):
        grid = exact.exact_grid(case, VALUES, fine=False)
        build = model.build(grid.sparse, VALUES)
        solution = model.solve(case, VALUES, fields=True)
        self.start, self.case = solution.fields[0], case
        t = kernels_terms
        self.pieces = []
        for span in grid.spans:
            steps = [span.at] if span.steady else range(span.at, span.at + span.last - span.first)
            rows, _ = exact.freeze(build, np.array(steps))
            edges = grid.case.edges
            self.pieces.append((edges[span.first], edges[span.last], rows))
        self.cap = self.pieces[0][2][0][t.CAP][:-1]
        self.series = case.outside
        self.calls = 0

    def at(self, piece, now):
        begin, end, rows = piece
        i = min(int((now - begin) / (end - begin) * len(rows)), len(rows) - 1)
        return rows[i]

    def outside(self, now):
        x = now * 10.0
        i = min(int(x), len(self.series) - 2)
        return self.series[i] + (x - i) * (self.series[i + 1] - self.series[i])

    def solve(self, method, rtol):
        t = kernels_terms
        times = self.case.run.time_s
        result = np.empty((len(times), len(self.start)))
        result[0], y = self.start, self.start
        for piece in self.pieces:
            begin, end, _ = piece

            def rate(now, y, piece=piece):
                self.calls += 1
                w = self.at(piece, now)
                g = w[t.G]
                low, top = self.outside(now)
                flow = np.empty(len(y) + 1)
                flow[1:-1] = g[1:-1] * (y[:-1] - y[1:])
                flow[0], flow[-1] = g[0] * (low - y[0]), g[-1] * (y[-1] - top)
                return (flow[:-1] - flow[1:] + w[t.LOSS][:-1] * (self.case.ambient - y)) / self.cap

            def jacobian(now, y, piece=piece):
                w = self.at(piece, now)
                inner = w[t.G][1:-1]
                return diags(
                    [inner / self.cap[1:], -w[t.DIAG][:-1] / self.cap, inner / self.cap[:-1]],
                    [-1, 0, 1],
                    format="csc",
                )

            rows = np.flatnonzero((times > begin + 1e-9) & (times < end + 1e-9))
            wanted = np.minimum(times[rows], end)
            if not len(wanted) or wanted[-1] < end - 1e-9:
                wanted = np.append(wanted, end)
            extra = {"lband": 1, "uband": 1} if method == "LSODA" else {"jac": jacobian}
            found = solve_ivp(rate, (begin, end), y, method, wanted, rtol=rtol, atol=rtol * 10.0, **extra)
            result[rows], y = found.y[:, : len(rows)].T, found.y[:, -1]
        return result


def fipy_cycle(lines):
    """The same cells in FiPy, backward Euler at 0.1 s."""
    import fipy

    t = kernels_terms
    dx = lines.case.mesh.dx
    mesh = fipy.Grid1D(dx=dx)
    T = fipy.CellVariable(mesh=mesh, value=lines.start)
    apart = np.concatenate([[dx[0] / 2], (dx[1:] + dx[:-1]) / 2, [dx[-1] / 2]])
    k = fipy.FaceVariable(mesh=mesh)
    gain, drain = fipy.CellVariable(mesh=mesh), fipy.CellVariable(mesh=mesh)
    equation = fipy.TransientTerm(coeff=fipy.CellVariable(mesh=mesh, value=lines.cap / dx)) == (
        fipy.DiffusionTerm(coeff=k) + gain - fipy.ImplicitSourceTerm(coeff=drain)
    )
    times = lines.case.run.time_s
    result = np.empty((len(times), len(dx)))
    result[0] = lines.start
    for row, now in enumerate(times[1:], start=1):
        piece = next(p for p in lines.pieces if now <= p[1] + 1e-9)
        w = lines.at(piece, now)
        g, loss = w[t.G], w[t.LOSS][:-1]
        k.setValue(np.concatenate([[0.0], g[1:-1] * apart[1:-1], [0.0]]))
        low, top = lines.outside(now)
        source, sink = loss * lines.case.ambient, loss.copy()
        source[0] += g[0] * low
        sink[0] += g[0]
        source[-1] += g[-1] * top
        sink[-1] += g[-1]
        gain.setValue(source / dx)
        drain.setValue(sink / dx)
        equation.solve(var=T, dt=0.1)
        result[row] = T.value
    return result


def pde_cycle(lines):
    """The same cells in py-pde, its SciPy solver with LSODA."""
    import pde

    t = kernels_terms

    class Stack(pde.PDEBase):
        def evolution_rate(self, state, t=0):
            piece = next((p for p in lines.pieces if t <= p[1]), lines.pieces[-1])
            w = lines.at(piece, t)
            y, g = state.data, w[kernels_terms.G]
            low, top = lines.outside(t)
            flow = np.empty(len(y) + 1)
            flow[1:-1] = g[1:-1] * (y[:-1] - y[1:])
            flow[0], flow[-1] = g[0] * (low - y[0]), g[-1] * (y[-1] - top)
            loss = w[kernels_terms.LOSS][:-1] * (lines.case.ambient - y)
            return pde.ScalarField(state.grid, (flow[:-1] - flow[1:] + loss) / lines.cap)

    del t
    times = lines.case.run.time_s
    grid = pde.UnitGrid([len(lines.start)])
    storage = pde.MemoryStorage()
    equation = Stack()
    tracker = storage.tracker(interrupts=pde.FixedInterrupts(times))
    equation.solve(
        pde.ScalarField(grid, lines.start), t_range=(0.0, float(times[-1])), solver="scipy", method="LSODA",
        tracker=tracker, backend="numpy",
    )  # fmt: skip
    return np.array(storage.data)


def seconds(call):
    start = time.thread_time()
    result = call()
    return (time.thread_time() - start) * 1e3, result


@pytest.mark.parametrize("noise", [0.0, 0.1], ids=["smooth platens", "platens with 0.1 K of noise"])
def test_press_cycle_beside_general_solvers(noise, capsys):
    model = ThermalModel(parse_press(PRESS))
    run = make_run(1, noise)
    case = model.prepare(run, MOMENTS, **GRID)
    keep = settled(run.time_s)
    truth = model.solve(case, VALUES, method="exact").places[keep]
    seven = model.parameter_names
    lines = MethodOfLines(model, case)

    def error(places):
        return float(np.abs(places[keep] - truth).max())

    rows = []

    def ours(label, names=(), method="implicit"):
        def call():
            return model.solve(case, VALUES, names, method=method)

        call()
        rows.append((label, least_ms(call), error(call().places)))

    ours("exact", method="exact")
    ours("exact, base + 7 tangents", seven, "exact")
    exact._remembered.clear()
    start = time.thread_time()
    model.solve(case, VALUES, method="exact")
    rows.append(("exact, new eigensystems", (time.thread_time() - start) * 1e3, 0.0))
    ours("implicit")
    ours("implicit, base + 7 tangents", seven)
    limit = max(0.05, rows[3][2])
    equal = {}
    for method in ("BDF", "LSODA"):
        for rtol in (1e-3, 1e-4, 1e-6):
            spent, fields = seconds(lambda m=method, r=rtol: lines.solve(m, r))
            wrong = error(fields @ case.places.T)
            rows.append((f"solve_ivp {method} rtol {rtol:g}", spent, wrong))
            if wrong <= limit:
                equal.setdefault(method, spent)
    for name, call in (("FiPy, backward Euler", fipy_cycle), ("py-pde, SciPy LSODA", pde_cycle)):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # rivals run as they come: what they warn of is theirs
                spent, fields = seconds(lambda call=call: call(lines))
        except ImportError:
            rows.append((f"{name}: not installed", np.nan, np.nan))
            continue
        rows.append((name, spent, error(fields @ case.places.T)))
    with capsys.disabled():
        print(
            f"\n{len(case.mesh.dx)} cells, {len(run.time_s)} rows, {len(case.h)} implicit steps, noise {noise} K"
        )
        print(f"{'method':34s} {'ms':>10s} {'max error K':>12s} {'x exact':>9s} {'x implicit':>11s}")
        for label, spent, wrong in rows:
            print(f"{label:34s} {spent:10.2f} {wrong:12.4f} {spent / rows[0][1]:9.1f} {spent / rows[3][1]:11.1f}")
        for method, spent in equal.items():
            print(
                f"at equal accuracy ({limit:.2g} K): {method} takes {spent / rows[0][1]:.0f} times the exact, "
                f"{spent / rows[3][1]:.0f} times the implicit solver"
            )


def test_hundred_runs_on_two_threads(capsys):
    model = ThermalModel(parse_press(PRESS))
    cases = [model.prepare(make_run(seed, 0.1), MOMENTS, **GRID) for seed in range(100)]
    with capsys.disabled():
        print(f"\n{'batch of 100 runs, two threads':34s} {'wall ms':>9s} {'ms a run and core':>18s}")
        for method in ("exact", "implicit"):
            for case in cases:
                model.solve(case, VALUES, method=method)
            best = (np.inf, np.inf)
            with ThreadPoolExecutor(2) as pool:
                for _ in range(3):
                    wall, spent = time.perf_counter(), time.process_time()
                    list(pool.map(lambda c, m=method: model.solve(c, VALUES, method=m), cases))
                    now = (time.perf_counter() - wall) * 1e3, (time.process_time() - spent) * 1e3
                    best = min(best, now, key=lambda pair: pair[1])
            print(f"{method:34s} {best[0]:9.0f} {best[1] / 100:18.2f}")
        keep = settled(cases[0].run.time_s)
        wrong = 0.0
        for case, found in zip(cases, solve_many(model, cases, VALUES), strict=True):
            truth = model.solve(case, VALUES, method="exact").places
            wrong = max(wrong, float(np.abs(found.places - truth)[keep].max()))
        best = (np.inf, np.inf)
        with ThreadPoolExecutor(2) as pool:
            for _ in range(10):
                wall, spent = time.perf_counter(), time.process_time()
                solve_many(model, cases, VALUES, pool.map)
                now = (time.perf_counter() - wall) * 1e3, (time.process_time() - spent) * 1e3
                best = min(best, now, key=lambda pair: pair[1])
        label = f"side by side, error {wrong:.3f} K"
        print(f"{label:34s} {best[0]:9.0f} {best[1] / 100:18.2f}")


def test_effects_beside_the_linear_model(capsys):
    press, run = parse_press(PRESS), make_run(1, 0.1)
    with capsys.disabled():
        print(f"\n{'implicit, one cycle':34s} {'ms':>8s} {'x linear':>9s} {'with all tangents':>18s}")
        linear = 0.0
        for name in ((), "moisture_evaporation", "vapour_convection", "resin_cure", "conductivity_temperature"):
            model = ThermalModel.of(press, [name] if name else [])
            case = model.prepare(run, MOMENTS, **GRID)
            values = model.guesses | VALUES
            model.solve(case, values, model.parameter_names)
            base = least_ms(lambda m=model, c=case, v=values: m.solve(c, v))
            full = least_ms(lambda m=model, c=case, v=values: m.solve(c, v, m.parameter_names), 7)
            linear = linear or base
            print(f"{name or 'linear':34s} {base:8.2f} {base / linear:9.1f} {full:18.2f}")


def test_cost_grows_linearly_with_steps_and_cells(capsys):
    model = ThermalModel(parse_press(PRESS))

    def timed(fineness, end, every):
        # the same steps however fine the cells are
        case = model.prepare(
            make_run(1, 0.1, end),
            MOMENTS,
            fineness=fineness,
            max_step_s=every * fineness,
            switch_step_s=0.03 * fineness,
        )
        spent = []
        for method in ("implicit", "exact"):
            model.solve(case, VALUES, method=method)
            spent.append(least_ms(lambda c=case, m=method: model.solve(c, VALUES, method=m), 9))
        return len(case.mesh.dx), len(case.h), len(case.run.time_s), *spent

    def curve(title, table, by):
        print(f"\n{title}\n{'cells':>6s} {'steps':>6s} {'rows':>6s} {'implicit ms':>12s} {'exact ms':>9s}")
        for row in table:
            bar = "#" * round(40 * row[3] / table[-1][3])
            print(f"{row[0]:6d} {row[1]:6d} {row[2]:6d} {row[3]:12.2f} {row[4]:9.2f}  {bar}")
        x = np.log([row[by] for row in table])
        powers = [np.polyfit(x, np.log([row[i] for row in table]), 1)[0] for i in (3, 4)]
        print(f"cost grows with the power {powers[0]:.2f} (implicit) and {powers[1]:.2f} (exact)")

    with capsys.disabled():
        curve("by cells", [timed(f, 300.0, 0.1) for f in (0.9, 1.8, 3.6, 7.2)], 0)
        curve("by steps", [timed(1.2, end, 0.1) for end in (300.0, 600.0, 1200.0, 2400.0)], 1)
