"""Time stepping of the virtual press: a Rosenbrock-W method of order 3 with step control, compiled.

The right-hand side is evaluated at full nonlinearity; only the matrix of the linear systems is
simplified (conduction, contacts, evaporation and sensor lag are in it, slow sources are not), which a
W-method allows without losing its order. ROS34PW2: Rang & Angermann, BIT 45 (2005) 761-787, written
for increments u = Γ k so that no product with the matrix is needed (Hairer & Wanner II, section IV.7).

Everything is per square metre of press. Temperatures in °C, time in s, conductances in W/m²K, heat
capacities of nodes in J/m²K. Nodes run from the lower plate's platen side to the upper plate's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from daq.compiled import compiled
from daq.records import COLDEST_C, STEFAN_BOLTZMANN, Array

GAMMA = 4.3586652150845900e-01
"""Of ROS34PW2, as all coefficients below (the paper named above)."""
_ALPHA = np.array(
    [
        [0.0, 0.0, 0.0, 0.0],
        [8.7173304301691801e-01, 0.0, 0.0, 0.0],
        [8.4457060015369423e-01, -1.1299064236484185e-01, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
    ]
)
_GAMMAS = np.array(
    [
        [GAMMA, 0.0, 0.0, 0.0],
        [-8.7173304301691801e-01, GAMMA, 0.0, 0.0],
        [-9.0338057013044082e-01, 5.4180672388095326e-02, GAMMA, 0.0],
        [2.4212380706095346e-01, -1.2232505839045147e00, 5.4526025533510214e-01, GAMMA],
    ]
)
_B = np.array([2.4212380706095346e-01, -1.2232505839045147e00, 1.5452602553351020e00, GAMMA])
_B_EMBEDDED = np.array([3.7810903145819369e-01, -9.6042292212423178e-02, 0.5, 2.1793326075422950e-01])
_INVERSE = np.linalg.inv(_GAMMAS)
A_U = np.tril(_ALPHA @ _INVERSE, -1)
C_U = np.tril(-_INVERSE, -1)
M_U = _B @ _INVERSE
E_U = (_B - _B_EMBEDDED) @ _INVERSE
T_STAGE = _ALPHA.sum(axis=1)
G_STAGE = _GAMMAS.sum(axis=1)

ZERO_C = -COLDEST_C
"""0 °C in kelvin. [K]"""
VAPOUR_C = 100.0
"""Steam leaves layers above this and condenses in cooler ones. [°C]"""
STEP_K = 3.0
"""How sharply laws that step do so. [K]"""
CURE_REFERENCE_K = 150.0 + ZERO_C
"""150 °C, where `CURE_RATE_150` holds. [K]"""

SIGNALS = (
    "panel_bottom",
    "panel_top",
    "plate_bottom",
    "plate_top",
    "core",
    "sensor_bottom",
    "sensor_top",
    "panel_mean",
    "enthalpy",
    "external_heat",
    "water",
    "cured",
)
"""What `advance` records after each step, in this order, behind the time."""


class Knobs(NamedTuple):
    """Every number that decides a pressing, in the kernel's units; see `daq.simulated.physics`."""

    h_p_o: float
    h_p_c: float
    h_pp_o: float
    h_pp_c: float
    h_wa: float
    h_ap: float
    ambient: float
    inserted: float
    close_0: float
    close_1: float
    open_0: float
    open_1: float
    removed: float
    k_slope: float
    c_slope: float
    deficit: float
    tau: float
    ratio: float
    k_step: float
    k_step_at: float
    broken: float
    broken_at: float
    load: float
    load_law: int
    load_by: float
    eased: float
    eased_from: float
    eased_to: float
    emissivity: float
    edge: float
    vapour: float
    vapour_uniform: bool
    inner: float
    """Power released about the middle of the panel while closed, where it is densest. [W/m³]"""
    evap_t: float
    evap_width: float
    evap_tau: float
    evap_kinetic: bool
    cure_heat: float
    cure_rate: float
    cure_kelvin: float
    paper_r: float
    footprint: float
    lag: float
    lapse_factor: float
    lapse_from: float
    lapse_to: float
    split_r: float
    split_from: float
    split_link: int
    draught: float
    draught_from: float
    lift: float
    lift_from: float
    wet_heat: float
    wet_release: float
    wet_return: float
    wet_width: float
    flash_rate: float
    flash_from: float
    flash_to: float


class PressStack(NamedTuple):
    """What stays the same over a pressing: nodes, their links and capacities, the platens' curves."""

    lower: int
    """Node of the lower plate's panel side."""
    first: int
    """The panel's first node."""
    last: int
    """The panel's last node."""
    upper: int
    """Node of the upper plate's panel side."""
    base: Array
    """Conductances; entry i lies below node i. Contacts and platens are filled in `links`."""
    capacity: Array
    volume: Array
    """Of panel nodes. [m³/m²]"""
    latent: Array
    """Heat to dry each panel node. [J/m²]"""
    skin: Array
    """Share of the resin's heat each panel node takes; for the lower face, mirrored for the upper."""
    wet: Array
    """Share of condensing steam's heat each panel node takes."""
    inner: Array
    """Volume of each panel node that a source about the middle fills. [m³/m²]"""
    start: float
    step: float
    low: Array
    high: Array
    """The platens' knots."""


class NodeState(NamedTuple):
    """What changes: or its rate of change, or a stage's increment."""

    T: Array
    w: Array
    """Water left in each panel node, 1 to 0."""
    x: Array
    """Cure of the lower and the upper face, heat from outside [J/m²], lower and upper thermocouple."""


class Instant(NamedTuple):
    """A time, and a time inside the stretch between two jumps that it belongs to, which decides what is on."""

    t: float
    middle: float


class Flow(NamedTuple):
    """Conductances below each node, and what each node loses to ambient; `links` fills them."""

    g: Array
    loss: Array


class Matrix(NamedTuple):
    """1/(γh) - J, its tridiagonal part eliminated; evaporation is folded into the pivots."""

    pivot: Array
    up: Array
    ratio: Array
    by_T: Array
    """Slope of each panel node's drying by its temperature."""
    by_w: Array
    heat: Array
    """Latent heat over heat capacity of each panel node. [K]"""


class StepTerms(NamedTuple):
    """What the matrix of a step rests on beside the state."""

    inverse: float
    """1/(γh). [1/s]"""
    inside: bool
    """Whether a panel is in the press."""
    moist: bool
    """Whether it dries."""
    mix: float
    """What the thermocouples feel of the plates."""


class Stepping(NamedTuple):
    """How finely `advance` goes."""

    tolerance: float
    """Of a step's local error. [K]"""
    longest: float
    """Step. [s]"""


@compiled(inner=True, nogil=True, error_model="numpy")
def platen(t: float, start: float, step: float, values: Array) -> float:
    """Return a platen's temperature: a Catmull-Rom curve through evenly spaced knots."""
    place = (t - start) / step
    last = values.size - 1
    i = min(max(int(np.floor(place)), 0), last - 1)
    s = min(max(place - i, 0.0), 1.0)
    b, c = values[i], values[i + 1]
    a, d = values[max(i - 1, 0)], values[min(i + 2, last)]
    return b + 0.5 * s * (c - a + s * (2 * a - 5 * b + 4 * c - d + s * (3 * (b - c) + d - a)))  # type: ignore[no-any-return]


@compiled(nogil=True, error_model="numpy")
def platen_curve(times: Array, start: float, step: float, values: Array) -> Array:
    """Return a platen's temperature at many times."""
    out = np.empty(times.size)
    for i in range(times.size):
        out[i] = platen(times[i], start, step, values)
    return out


@compiled(inner=True, nogil=True, error_model="numpy")
def copy(source: Array, target: Array) -> None:
    """Copy an array: a loop compiles in a tenth of the time a slice takes, for want of its error message."""
    for i in range(source.size):
        target[i] = source[i]


@compiled(inner=True, nogil=True, error_model="numpy")
def largest(values: Array) -> float:
    """Return the largest absolute value."""
    found = 0.0
    for i in range(values.size):
        found = max(found, abs(values[i]))
    return found


@compiled(inner=True, nogil=True, error_model="numpy")
def closed_fraction(t: float, k: Knobs) -> float:
    """Return how far the press is closed, 0 to 1, linear in both ramps."""
    if t < k.close_1:
        return min(max((t - k.close_0) / (k.close_1 - k.close_0), 0.0), 1.0)
    return 1.0 - min(max((t - k.open_0) / (k.open_1 - k.open_0), 0.0), 1.0)


@compiled(inner=True, nogil=True, error_model="numpy")
def present(middle: float, k: Knobs) -> bool:
    """Return whether a panel is in the press."""
    return k.inserted < middle < k.removed


@compiled(inner=True, nogil=True, error_model="numpy")
def links(at: Instant, T: Array, k: Knobs, s: PressStack, flow: Flow) -> float:
    """Fill conductances and losses; return the closed fraction."""
    n, g, loss = T.size, flow.g, flow.loss
    f = closed_fraction(at.t, k) if present(at.middle, k) else 0.0
    copy(s.base, g)
    for i in range(n):
        loss[i] = 0.0
    g[0] = g[n] = k.h_p_o + f * (k.h_p_c - k.h_p_o)
    if not present(at.middle, k):
        g[s.lower + 1] = 0.0
        g[s.upper] = 0.0
        loss[s.lower] = k.h_ap
        loss[s.upper] = k.h_ap
        return f
    if k.k_slope != 0.0:
        for i in range(s.first, s.last):
            g[i + 1] *= 1.0 + k.k_slope * (0.5 * (T[i] + T[i + 1]) - 20.0)
    if k.k_step != 0.0:
        for i in range(s.first, s.last):
            g[i + 1] *= stepped(0.5 * (T[i] + T[i + 1]), k.k_step, k.k_step_at)
    if k.split_r > 0.0 and at.middle > k.split_from:
        opened = k.split_r * min((at.t - k.split_from) / 2.0, 1.0)
        g[k.split_link] /= 1.0 + opened * g[k.split_link]
    contacts(at, f, T, k, s, flow)
    return f


@compiled(inner=True, nogil=True, error_model="numpy")
def stepped(t: float, lost: float, at: float) -> float:
    """Return a factor that falls from 1 by `lost` about a temperature, over some kelvins."""
    return 1.0 - lost / (1.0 + np.exp(-(t - at) / STEP_K))  # type: ignore[no-any-return]


@compiled(inner=True, nogil=True, error_model="numpy")
def pressed(t: float, k: Knobs) -> float:
    """Return the factor on closed contacts by pressure, 1 at the reference: a power of it, or levelling off."""
    if k.load_by == 0.0:
        return 1.0
    load = k.load * (1.0 - (1.0 - k.eased) * min(max((t - k.eased_from) / (k.eased_to - k.eased_from), 0.0), 1.0))
    if k.load_law == 0:
        return load**k.load_by  # type: ignore[no-any-return]
    return (1.0 - np.exp(-load / k.load_by)) / (1.0 - np.exp(-1.0 / k.load_by))  # type: ignore[no-any-return]


@compiled(inner=True, nogil=True, error_model="numpy")
def contacts(at: Instant, f: float, T: Array, k: Knobs, s: PressStack, flow: Flow) -> None:
    """Fill the links between plates and panel, and what the open faces lose to air."""
    g, loss, middle = flow.g, flow.loss, at.middle
    since = max(at.t - 0.5 * (k.close_0 + k.close_1), 0.0)
    grown = k.h_pp_c * pressed(at.t, k) * (1.0 - k.deficit * np.exp(-since / k.tau))
    resting = k.h_pp_o * (k.lift if middle > k.lift_from else 1.0)
    lower, upper = resting + f * (grown - resting), f * grown * k.ratio
    if k.broken != 0.0:
        lower = resting + f * (grown * stepped(T[s.first], k.broken, k.broken_at) - resting)
        upper *= stepped(T[s.last], k.broken, k.broken_at)
    if k.lapse_from < middle < k.lapse_to:
        upper *= k.lapse_factor
    if k.emissivity > 0.0 and f < 1.0:
        a, b = T[s.upper] + ZERO_C, T[s.upper - 1] + ZERO_C
        upper += (1.0 - f) * k.emissivity * STEFAN_BOLTZMANN * (a * a + b * b) * (a + b)
    air = (1.0 - f) * (k.draught if middle > k.draught_from else 1.0)
    half = 0.5 * k.paper_r
    g[s.lower + 1] = lower / (1.0 + lower * half)
    g[s.upper] = upper / (1.0 + upper * half)
    loss[s.upper - 1] = k.h_wa * air / (1.0 + k.h_wa * air * half)
    loss[s.upper] = k.h_ap * air


@compiled(inner=True, nogil=True, error_model="numpy")
def drying(T: float, w: float, k: Knobs) -> tuple[float, float, float]:
    """Return the rate of the water left and its slopes by temperature and by water left."""
    distance = (T - k.evap_t) / k.evap_width
    e = np.exp(-abs(distance))
    if k.evap_kinetic:
        soft = max(distance, 0.0) + np.log1p(e)
        rise = 1.0 / (1.0 + e) if distance > 0 else e / (1.0 + e)
        pace = 0.08 / k.evap_tau
        return -pace * w * soft, -pace * w * rise / k.evap_width, -pace * soft
    equilibrium = e / (1.0 + e) if distance > 0 else 1.0 / (1.0 + e)
    if w <= equilibrium:
        return 0.0, 0.0, 0.0
    fall = -e / ((1.0 + e) * (1.0 + e)) / k.evap_width
    return -(w - equilibrium) / k.evap_tau, fall / k.evap_tau, -1.0 / k.evap_tau


@compiled(inner=True, nogil=True, error_model="numpy")
def curing(face: float, k: Knobs) -> float:
    """Return the resin's rate constant. [1/s]"""
    return k.cure_rate * np.exp(-k.cure_kelvin * (1.0 / (face + ZERO_C) - 1.0 / CURE_REFERENCE_K))  # type: ignore[no-any-return]


@compiled(inner=True, nogil=True, error_model="numpy")
def steam(f: float, T: Array, k: Knobs, s: PressStack, q: Array) -> None:
    """Move heat from layers above 100 °C to cooler ones; what one gives the others take."""
    hot = room = 0.0
    for i in range(s.volume.size):
        above = T[s.first + i] - VAPOUR_C
        hot += s.volume[i] * max(above, 0.0)
        room += s.volume[i] * (min(max(-above, 0.0) / 5.0, 1.0) if k.vapour_uniform else max(-above, 0.0))
    if hot == 0.0 or room == 0.0:
        return
    spare = 1e-4 if k.vapour_uniform else 1e-3
    strength = f * k.vapour * room / (room + spare)
    for i in range(s.volume.size):
        above = T[s.first + i] - VAPOUR_C
        share = min(max(-above, 0.0) / 5.0, 1.0) if k.vapour_uniform else max(-above, 0.0)
        q[s.first + i] += strength * s.volume[i] * (hot * share / room - max(above, 0.0))


@compiled(inner=True, nogil=True, error_model="numpy")
def sources(at: Instant, f: float, y: NodeState, k: Knobs, s: PressStack, d: NodeState) -> float:
    """Add what happens inside the panel to the heat flows `d.T` [W/m²]; return the heat from outside."""
    m, external = s.volume.size, 0.0
    if k.edge > 0.0:
        for i in range(m):
            q = k.edge * s.volume[i] * (y.T[s.first + i] - k.ambient)
            d.T[s.first + i] -= q
            external -= q
    if k.flash_rate > 0.0 and k.flash_from < at.middle < k.flash_to:
        for i in range(m):
            q = k.flash_rate * s.capacity[s.first + i] * max(y.T[s.first + i] - VAPOUR_C, 0.0)
            d.T[s.first + i] -= q
            external -= q
    if s.latent[0] > 0.0:
        for i in range(m):
            d.w[i] = drying(y.T[s.first + i], y.w[i], k)[0]
            d.T[s.first + i] += s.latent[i] * d.w[i]
    if k.cure_heat > 0.0:
        d.x[0] = curing(y.T[s.first], k) * (1.0 - y.x[0])
        d.x[1] = curing(y.T[s.last], k) * (1.0 - y.x[1])
        for i in range(m):
            d.T[s.first + i] += k.cure_heat * (s.skin[i] * d.x[0] + s.skin[m - 1 - i] * d.x[1])
    if k.vapour > 0.0 and f > 0.0:
        steam(f, y.T, k, s, d.T)
    if k.inner > 0.0:
        for i in range(m):
            q = f * k.inner * s.inner[i]
            d.T[s.first + i] += q
            external += q
    if k.wet_heat > 0.0:
        a, b = (at.t - k.wet_release) / k.wet_width, 0.5 * (at.t - k.wet_return) / k.wet_width
        power = k.wet_heat * 0.3989422804 / k.wet_width * (np.exp(-0.5 * a * a) - 0.5 * np.exp(-0.5 * b * b))
        for i in range(m):
            d.T[s.first + i] += power * s.wet[i]
        external += power
    return external


@compiled(nogil=True, error_model="numpy")
def slope(at: Instant, y: NodeState, k: Knobs, s: PressStack, flow: Flow, d: NodeState) -> float:
    """Fill the rates of change `d` (and links on the way); return the closed fraction."""
    T, n, g, loss = y.T, y.T.size, flow.g, flow.loss
    f: float = links(at, T, k, s, flow)
    low, high = platen(at.t, s.start, s.step, s.low), platen(at.t, s.start, s.step, s.high)
    external = g[0] * (low - T[0]) + g[n] * (high - T[n - 1])
    for i in range(n):
        below = T[i - 1] if i > 0 else low
        above = T[i + 1] if i < n - 1 else high
        lost = loss[i] * (T[i] - k.ambient)
        d.T[i] = g[i] * (below - T[i]) + g[i + 1] * (above - T[i]) - lost
        external -= lost
    for i in range(5):
        d.x[i] = 0.0
    for i in range(d.w.size):
        d.w[i] = 0.0
    if present(at.middle, k):
        external += sources(at, f, y, k, s, d)
    for i in range(n):
        d.T[i] /= s.capacity[i]
    for i in range(s.first, s.last + 1):
        d.T[i] /= 1.0 + k.c_slope * (T[i] - 20.0)
    d.x[2] = external
    if k.lag > 0.0:
        mix = k.footprint * f
        d.x[3] = ((1.0 - mix) * T[s.first] + mix * T[s.lower] - y.x[3]) / k.lag
        d.x[4] = ((1.0 - mix) * T[s.last] + mix * T[s.upper] - y.x[4]) / k.lag
    return f


@compiled(inner=True, nogil=True, error_model="numpy")
def factor(step: StepTerms, y: NodeState, k: Knobs, s: PressStack, flow: Flow, a: Matrix) -> None:
    """Fill the matrix at one state, with links and losses already known."""
    n, g, loss, inverse = y.T.size, flow.g, flow.loss, step.inverse
    for i in range(n):
        c = s.capacity[i]
        if s.first <= i <= s.last:
            j = i - s.first
            c *= 1.0 + k.c_slope * (y.T[i] - 20.0)
            a.heat[j] = s.latent[j] / c
        a.up[i] = -g[i + 1] / c
        a.ratio[i] = -g[i] / c
        a.pivot[i] = inverse + (g[i] + g[i + 1] + loss[i]) / c
        if step.inside and s.first <= i <= s.last:
            a.pivot[i] += k.edge * s.volume[i - s.first] / c
            if step.moist:
                _, a.by_T[j], a.by_w[j] = drying(y.T[i], y.w[j], k)
                a.pivot[i] -= a.heat[j] * a.by_T[j] * inverse / (inverse - a.by_w[j])
    for i in range(1, n):
        a.ratio[i] /= a.pivot[i - 1]
        a.pivot[i] -= a.ratio[i] * a.up[i - 1]


@compiled(inner=True, nogil=True, error_model="numpy")
def back_substitute(step: StepTerms, k: Knobs, s: PressStack, a: Matrix, z: NodeState, u: NodeState) -> None:
    """Solve the matrix for one stage: right-hand side `z` (spoilt), increment `u`."""
    n, inverse, moist, mix = z.T.size, step.inverse, step.moist, step.mix
    if moist:
        for i in range(z.w.size):
            z.T[s.first + i] += a.heat[i] * a.by_w[i] * z.w[i] / (inverse - a.by_w[i])
    for i in range(1, n):
        z.T[i] -= a.ratio[i] * z.T[i - 1]
    u.T[n - 1] = z.T[n - 1] / a.pivot[n - 1]
    for i in range(n - 2, -1, -1):
        u.T[i] = (z.T[i] - a.up[i] * u.T[i + 1]) / a.pivot[i]
    if moist:
        for i in range(z.w.size):
            u.w[i] = (z.w[i] + a.by_T[i] * u.T[s.first + i]) / (inverse - a.by_w[i])
    for j in range(3):
        u.x[j] = z.x[j] / inverse
    if k.lag > 0.0:
        low = (1.0 - mix) * u.T[s.first] + mix * u.T[s.lower]
        high = (1.0 - mix) * u.T[s.last] + mix * u.T[s.upper]
        u.x[3] = (z.x[3] + low / k.lag) / (inverse + 1.0 / k.lag)
        u.x[4] = (z.x[4] + high / k.lag) / (inverse + 1.0 / k.lag)


@compiled(inner=True, nogil=True, error_model="numpy")
def combine(out: NodeState, start: NodeState, weights: Array, over: float, u: NodeState) -> None:
    """Set `out` to `start` plus the sum of the increments, the rows of `u`, by their weights over `over`."""
    copy(start.T, out.T)
    copy(start.w, out.w)
    copy(start.x, out.x)
    for j in range(weights.size):
        c = weights[j] / over
        if c == 0.0:
            continue
        for i in range(out.T.size):
            out.T[i] += c * u.T[j, i]
        for i in range(out.w.size):
            out.w[i] += c * u.w[j, i]
        for i in range(5):
            out.x[i] += c * u.x[j, i]


@compiled(inner=True, nogil=True, error_model="numpy")
def record(t: float, y: NodeState, f: float, k: Knobs, s: PressStack, row: Array) -> None:
    """Write the time and `SIGNALS`."""
    T = y.T
    mix = k.footprint * f
    row[0] = t
    row[1], row[2] = T[s.first], T[s.last]
    row[3], row[4] = T[s.lower], T[s.upper]
    row[5] = T[s.first + s.volume.size // 2]
    row[6] = y.x[3] if k.lag > 0.0 else (1.0 - mix) * T[s.first] + mix * T[s.lower]
    row[7] = y.x[4] if k.lag > 0.0 else (1.0 - mix) * T[s.last] + mix * T[s.upper]
    heat = mean = whole = water = 0.0
    for i in range(T.size):
        heat += s.capacity[i] * T[i]
    for i in range(s.volume.size):
        c, above = s.capacity[s.first + i], T[s.first + i] - 20.0
        heat += 0.5 * k.c_slope * c * above * above
        mean += c * T[s.first + i]
        whole += c
        water += s.latent[i] * y.w[i]
    row[8], row[9], row[10], row[11] = mean / whole, heat, y.x[2], water
    row[12] = 0.5 * (y.x[0] + y.x[1])


@compiled(inner=True, nogil=True, error_model="numpy")
def blank(n: int, m: int) -> NodeState:
    """Return a state of zeros."""
    return NodeState(np.zeros(n), np.zeros(m), np.zeros(5))


@compiled(nogil=True, error_model="numpy")
def advance(span: tuple[float, float], y: NodeState, k: Knobs, s: PressStack, how: Stepping, out: Array) -> int:
    """Integrate from begin to end of `span` (no jump between them), changing `y` in place.

    Rows are written to `out`, the first one at the begin itself; returns how many, -1 where there is no more room.
    """
    n, m = y.T.size, y.w.size
    t, end = span
    middle = 0.5 * (t + end)
    inside = present(middle, k)
    moist = inside and s.latent[0] > 0.0
    flow, unused = Flow(np.empty(n + 1), np.empty(n)), Flow(np.empty(n + 1), np.empty(n))
    u = NodeState(np.zeros((4, n)), np.zeros((4, m)), np.zeros((4, 5)))
    stage, rate, drift, z, zero = blank(n, m), blank(n, m), blank(n, m), blank(n, m), blank(n, m)
    a = Matrix(np.empty(n), np.empty(n), np.empty(n), np.zeros(m), np.zeros(m), np.zeros(m))
    record(t, y, closed_fraction(t, k) if inside else 0.0, k, s, out[0])
    row = 1
    h = min(1e-3, end - t)
    while t < end - 1e-9:
        if row >= out.shape[0]:
            return -1
        if t + 1.01 * h > end:
            h = end - t
        inverse = 1.0 / (GAMMA * h)
        mix = k.footprint * slope(Instant(t, middle), y, k, s, flow, rate)
        step = StepTerms(inverse, inside, moist, mix)
        factor(step, y, k, s, flow, a)
        slope(Instant(t + 1e-3 * h, middle), y, k, s, unused, drift)
        for i in range(n):
            drift.T[i] = (drift.T[i] - rate.T[i]) / (1e-3 * h)
        for i in range(5):
            drift.x[i] = (drift.x[i] - rate.x[i]) / (1e-3 * h)
        for j in range(4):
            if j > 0:
                combine(stage, y, A_U[j], 1.0, u)
                slope(Instant(t + T_STAGE[j] * h, middle), stage, k, s, unused, rate)
            combine(z, rate, C_U[j], h, u)
            for i in range(n):
                z.T[i] += G_STAGE[j] * h * drift.T[i]
            for i in range(5):
                z.x[i] += G_STAGE[j] * h * drift.x[i]
            back_substitute(step, k, s, a, z, NodeState(u.T[j], u.w[j], u.x[j]))
        combine(stage, zero, E_U, 1.0, u)
        error = largest(stage.T)
        error = max(error, 5.0 * largest(stage.w), abs(stage.x[3]), abs(stage.x[4])) / how.tolerance
        if error > 1.0 and h > 1e-6:
            h *= max(0.2, 0.85 * error ** (-1.0 / 3.0))
            continue
        t += h
        combine(stage, y, M_U, 1.0, u)
        copy(stage.T, y.T)
        copy(stage.w, y.w)
        copy(stage.x, y.x)
        record(t, y, closed_fraction(min(t, end), k) if inside else 0.0, k, s, out[row])
        row += 1
        h = min(h * min(2.5, 0.85 * max(error, 1e-4) ** (-1.0 / 3.0)), how.longest)
    return row


@compiled(nogil=True, error_model="numpy")
def interpolate(t: Array, y: Array, bounds: Array, at: Array) -> Array:
    """Return `y` at any times: cubic through the steps, slopes of parabolas, never across a jump.

    `bounds` holds the first row of each stretch and one past the last; at a jump's own time the
    later stretch counts. A stretch has two rows at least.
    """
    out = np.empty(at.size)
    for j in range(at.size):
        s = 0
        while s < bounds.size - 2 and at[j] >= t[bounds[s + 1]]:
            s += 1
        first, last = bounds[s], bounds[s + 1] - 1
        low, high = first, last
        while high - low > 1:
            half = (low + high) // 2
            if t[half] <= at[j]:
                low = half
            else:
                high = half
        h = t[low + 1] - t[low]
        d = (y[low + 1] - y[low]) / h
        before, after = d, d
        if low > first:
            g = t[low] - t[low - 1]
            before = ((y[low] - y[low - 1]) / g * h + d * g) / (g + h)
        if low + 1 < last:
            g = t[low + 2] - t[low + 1]
            after = ((y[low + 2] - y[low + 1]) / g * h + d * g) / (g + h)
        if low == first:
            before = 2.0 * d - after
        if low + 1 == last:
            after = 2.0 * d - before
        x = min(max((at[j] - t[low]) / h, 0.0), 1.0)
        out[j] = y[low] + h * x * (d + (1.0 - x) * ((before - d) * (1.0 - x) - (after - d) * x))
    return out
