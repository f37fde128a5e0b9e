# mypy: disallow_untyped_defs=False
"""Time stepping of the virtual press: a Rosenbrock-W method of order 3 with step control, compiled.

The right-hand side is evaluated at full nonlinearity; only the matrix of the linear systems is
simplified (conduction, contacts, evaporation and sensor lag are in it, slow sources are not), which a
W-method allows without losing its order. ROS34PW2: Rang & Angermann, BIT 45 (2005) 761-787.

Everything is per square metre of press. Temperatures in °C, time in s, conductances in W/m²K, heat
capacities of nodes in J/m²K.
"""

from __future__ import annotations

import numpy as np
from numba import njit

GAMMA = 4.3586652150845900e-01
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
_BHAT = np.array([3.7810903145819369e-01, -9.6042292212423178e-02, 0.5, 2.1793326075422950e-01])
_INVERSE = np.linalg.inv(_GAMMAS)
A_U = _ALPHA @ _INVERSE
C_U = np.diag(np.full(4, 1.0 / GAMMA)) - _INVERSE
M_U = _B @ _INVERSE
E_U = (_B - _BHAT) @ _INVERSE
T_STAGE = _ALPHA.sum(axis=1)
G_STAGE = _GAMMAS.sum(axis=1)

PARAMETERS = (
    "h_p_o",
    "h_p_c",
    "h_pp_o",
    "h_pp_c",
    "h_wa",
    "h_ap",
    "ambient",
    "inserted",
    "close_0",
    "close_1",
    "open_0",
    "open_1",
    "removed",
    "k_slope",
    "c_slope",
    "deficit",
    "tau",
    "ratio",
    "emissivity",
    "edge",
    "vapour",
    "vapour_uniform",
    "evap_t",
    "evap_width",
    "evap_tau",
    "evap_kinetic",
    "cure_heat",
    "cure_rate",
    "cure_kelvin",
    "paper_r",
    "footprint",
    "lag",
    "lapse_factor",
    "lapse_from",
    "lapse_to",
    "split_r",
    "split_from",
    "split_node",
    "draught",
    "draught_from",
    "lift",
    "lift_from",
    "wet_heat",
    "wet_release",
    "wet_return",
    "wet_width",
)
"""Order of the parameter vector ``p``; `Pressing` in `daq.simulated.physics` fills it."""

(
    H_P_O,
    H_P_C,
    H_PP_O,
    H_PP_C,
    H_WA,
    H_AP,
    AMBIENT,
    INSERTED,
    CLOSE_0,
    CLOSE_1,
    OPEN_0,
    OPEN_1,
    REMOVED,
    K_SLOPE,
    C_SLOPE,
    DEFICIT,
    TAU,
    RATIO,
    EMISSIVITY,
    EDGE,
    VAPOUR,
    VAPOUR_UNIFORM,
    EVAP_T,
    EVAP_WIDTH,
    EVAP_TAU,
    EVAP_KINETIC,
    CURE_HEAT,
    CURE_RATE,
    CURE_KELVIN,
    PAPER_R,
    FOOTPRINT,
    LAG,
    LAPSE_FACTOR,
    LAPSE_FROM,
    LAPSE_TO,
    SPLIT_R,
    SPLIT_FROM,
    SPLIT_NODE,
    DRAUGHT,
    DRAUGHT_FROM,
    LIFT,
    LIFT_FROM,
    WET_HEAT,
    WET_RELEASE,
    WET_RETURN,
    WET_WIDTH,
) = range(len(PARAMETERS))

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
"""What `advance` records after each step, in this order."""

STEFAN_BOLTZMANN = 5.670374419e-8
VAPOUR_C = 100.0
"""Steam leaves layers above this and condenses in cooler ones. [°C]"""


@njit(cache=True)
def platen(t, start, step, values):
    """Return a platen's temperature: a Catmull-Rom curve through evenly spaced knots."""
    x = (t - start) / step
    last = values.size - 1
    i = min(max(int(np.floor(x)), 0), last - 1)
    s = min(max(x - i, 0.0), 1.0)
    v1, v2 = values[i], values[i + 1]
    v0 = values[max(i - 1, 0)]
    v3 = values[min(i + 2, last)]
    return v1 + 0.5 * s * (v2 - v0 + s * (2 * v0 - 5 * v1 + 4 * v2 - v3 + s * (3 * (v1 - v2) + v3 - v0)))


@njit(cache=True)
def platen_curve(times, start, step, values):
    """Return a platen's temperature at many times."""
    out = np.empty(times.size)
    for i in range(times.size):
        out[i] = platen(times[i], start, step, values)
    return out


@njit(cache=True)
def closed_fraction(t, p):
    """Return how far the press is closed, 0 to 1, linear in both ramps."""
    if t < p[CLOSE_1]:
        return min(max((t - p[CLOSE_0]) / (p[CLOSE_1] - p[CLOSE_0]), 0.0), 1.0)
    return 1.0 - min(max((t - p[OPEN_0]) / (p[OPEN_1] - p[OPEN_0]), 0.0), 1.0)


@njit(cache=True)
def links(t, middle, T, p, layout, base, g, loss):
    """Fill `g` (between neighbours; ends to the platens) and `loss` (of each node to ambient).

    `middle` is a time inside the current stretch between two jumps: it decides what is on.
    """
    nb, p0, p1, n = layout[0], layout[1], layout[2], T.size
    top = p1 + n - nb - p1  # first node of the upper plate
    present = p[INSERTED] < middle < p[REMOVED]
    f = closed_fraction(t, p) if present else 0.0
    g[:] = base
    for i in range(n):
        loss[i] = 0.0
    h_p = p[H_P_O] + f * (p[H_P_C] - p[H_P_O])
    g[0] = h_p
    g[n] = h_p
    air = p[DRAUGHT] if middle > p[DRAUGHT_FROM] else 1.0
    if not present:
        g[nb] = 0.0
        g[top] = 0.0
        loss[nb - 1] = p[H_AP]
        loss[top] = p[H_AP]
        return f
    if p[K_SLOPE] != 0.0:
        for i in range(p0, p1 - 1):
            g[i + 1] *= 1.0 + p[K_SLOPE] * (0.5 * (T[i] + T[i + 1]) - 20.0)
    if p[SPLIT_R] > 0.0 and middle > p[SPLIT_FROM]:
        j = int(p[SPLIT_NODE])
        opened = p[SPLIT_R] * min((t - p[SPLIT_FROM]) / 2.0, 1.0)
        g[j + 1] = 1.0 / (1.0 / g[j + 1] + opened)
    grown = p[H_PP_C] * (1.0 - p[DEFICIT] * np.exp(-max(t - 0.5 * (p[CLOSE_0] + p[CLOSE_1]), 0.0) / p[TAU]))
    lower = p[H_PP_O] * (p[LIFT] if middle > p[LIFT_FROM] else 1.0)
    lower += f * (grown - lower)
    upper = f * grown * p[RATIO]
    if p[LAPSE_FROM] < middle < p[LAPSE_TO]:
        upper *= p[LAPSE_FACTOR]
    if p[EMISSIVITY] > 0.0 and f < 1.0:
        a, b = T[top] + 273.15, T[top - 1] + 273.15
        upper += (1.0 - f) * p[EMISSIVITY] * STEFAN_BOLTZMANN * (a * a + b * b) * (a + b)
    film = (1.0 - f) * p[H_WA] * air
    half = 0.5 * p[PAPER_R]
    g[nb] = lower / (1.0 + lower * half)
    g[top] = upper / (1.0 + upper * half)
    loss[top - 1] = film / (1.0 + film * half)
    loss[top] = (1.0 - f) * p[H_AP] * air
    return f


@njit(cache=True)
def drying(T, w, p):
    """Return the rate of the remaining water fraction and its slopes by temperature and fraction."""
    x = (T - p[EVAP_T]) / p[EVAP_WIDTH]
    if p[EVAP_KINETIC] > 0.5:
        e = np.exp(-abs(x))
        soft = max(x, 0.0) + np.log1p(e)
        slope = 1.0 / (1.0 + e) if x > 0 else e / (1.0 + e)
        k = 0.08 / p[EVAP_TAU]
        return -k * w * soft, -k * w * slope / p[EVAP_WIDTH], -k * soft
    if x < -30.0:
        return 0.0, 0.0, 0.0
    e = np.exp(-abs(x))
    equilibrium = e / (1.0 + e) if x > 0 else 1.0 / (1.0 + e)
    if w <= equilibrium:
        return 0.0, 0.0, 0.0
    slope = -e / ((1.0 + e) * (1.0 + e)) / p[EVAP_WIDTH]
    return -(w - equilibrium) / p[EVAP_TAU], slope / p[EVAP_TAU], -1.0 / p[EVAP_TAU]


@njit(cache=True)
def slope(
    t,
    middle,
    T,
    w,
    x,
    p,
    layout,
    base,
    cap,
    volume,
    latent,
    skin,
    wet,
    start,
    step,
    low,
    high,
    g,
    loss,
    dT,
    dw,
    dx,
):
    """Fill the time derivatives of temperatures, water fractions and auxiliary states; return f.

    `x` holds cure of the lower and upper face, external heat [J/m²], lower and upper sensor.
    """
    nb, p0, p1, n = layout[0], layout[1], layout[2], T.size
    f = links(t, middle, T, p, layout, base, g, loss)
    present = p[INSERTED] < middle < p[REMOVED]
    ambient = p[AMBIENT]
    below = platen(t, start, step, low)
    external = 0.0
    for i in range(n):
        above = T[i + 1] if i < n - 1 else platen(t, start, step, high)
        q = g[i] * (below - T[i]) + g[i + 1] * (above - T[i]) - loss[i] * (T[i] - ambient)
        external -= loss[i] * (T[i] - ambient)
        if i == 0:
            external += g[0] * (below - T[0])
        if i == n - 1:
            external += g[n] * (above - T[i])
        dT[i] = q
        below = T[i]
    for j in range(5):
        dx[j] = 0.0
    for i in range(p1 - p0):
        dw[i] = 0.0
    if present:
        external += sources(t, f, T, w, x, p, layout, volume, latent, skin, wet, dT, dw, dx)
    for i in range(n):
        dT[i] /= cap[i]
    if p[C_SLOPE] != 0.0:
        for i in range(p0, p1):
            dT[i] /= 1.0 + p[C_SLOPE] * (T[i] - 20.0)
    dx[2] = external
    if p[LAG] > 0.0:
        m = p[FOOTPRINT] * f
        top = p1 + n - nb - p1
        dx[3] = ((1.0 - m) * T[p0] + m * T[nb - 1] - x[3]) / p[LAG]
        dx[4] = ((1.0 - m) * T[p1 - 1] + m * T[top] - x[4]) / p[LAG]
    return f


@njit(cache=True)
def sources(t, f, T, w, x, p, layout, volume, latent, skin, wet, dT, dw, dx):
    """Add what happens inside the panel to the heat flows `dT` [W/m²]; return the heat from outside."""
    p0, p1 = layout[1], layout[2]
    m = p1 - p0
    external = 0.0
    if p[EDGE] > 0.0:
        for i in range(m):
            q = p[EDGE] * volume[i] * (T[p0 + i] - p[AMBIENT])
            dT[p0 + i] -= q
            external -= q
    if latent[0] > 0.0:
        for i in range(m):
            dw[i] = drying(T[p0 + i], w[i], p)[0]
            dT[p0 + i] += latent[i] * dw[i]
    if p[CURE_HEAT] > 0.0:
        for side in range(2):
            face = T[p0] if side == 0 else T[p1 - 1]
            dx[side] = (
                p[CURE_RATE] * np.exp(-p[CURE_KELVIN] * (1.0 / (face + 273.15) - 1.0 / 423.15)) * (1.0 - x[side])
            )
        for i in range(m):
            dT[p0 + i] += p[CURE_HEAT] * (skin[i] * dx[0] + skin[m - 1 - i] * dx[1])
    if p[VAPOUR] > 0.0 and f > 0.0:
        hot = 0.0
        room = 0.0
        for i in range(m):
            d = T[p0 + i] - VAPOUR_C
            if d > 0.0:
                hot += volume[i] * d
            else:
                room += volume[i] * (min(-d / 5.0, 1.0) if p[VAPOUR_UNIFORM] > 0.5 else -d)
        if hot > 0.0 and room > 0.0:
            spare = 1e-3 if p[VAPOUR_UNIFORM] < 0.5 else 1e-4
            taken = f * p[VAPOUR] * room / (room + spare)
            for i in range(m):
                d = T[p0 + i] - VAPOUR_C
                if d > 0.0:
                    dT[p0 + i] -= taken * volume[i] * d
                else:
                    share = min(-d / 5.0, 1.0) if p[VAPOUR_UNIFORM] > 0.5 else -d
                    dT[p0 + i] += taken * hot * volume[i] * share / room
    if p[WET_HEAT] > 0.0:
        a = (t - p[WET_RELEASE]) / p[WET_WIDTH]
        b = (t - p[WET_RETURN]) / (2.0 * p[WET_WIDTH])
        power = p[WET_HEAT] * 0.3989422804 / p[WET_WIDTH] * (np.exp(-0.5 * a * a) - 0.5 * np.exp(-0.5 * b * b))
        for i in range(m):
            dT[p0 + i] += power * wet[i]
        external += 2.0 * power
    return external


@njit(cache=True)
def record(t, T, w, x, f, p, layout, cap, latent, out, k):
    """Write one row of `SIGNALS` behind the time."""
    nb, p0, p1, n = layout[0], layout[1], layout[2], T.size
    top = p1 + n - nb - p1
    m = p1 - p0
    out[k, 0] = t
    out[k, 1] = T[p0]
    out[k, 2] = T[p1 - 1]
    out[k, 3] = T[nb - 1]
    out[k, 4] = T[top]
    out[k, 5] = T[p0 + m // 2]
    mix = p[FOOTPRINT] * f
    lagging = p[LAG] > 0.0
    out[k, 6] = x[3] if lagging else (1.0 - mix) * T[p0] + mix * T[nb - 1]
    out[k, 7] = x[4] if lagging else (1.0 - mix) * T[p1 - 1] + mix * T[top]
    heat = 0.0
    for i in range(n):
        heat += cap[i] * T[i]
    mean = 0.0
    water = 0.0
    whole = 0.0
    for i in range(m):
        d = T[p0 + i] - 20.0
        heat += 0.5 * p[C_SLOPE] * cap[p0 + i] * d * d
        mean += cap[p0 + i] * T[p0 + i]
        whole += cap[p0 + i]
        water += latent[i] * w[i]
    out[k, 8] = mean / whole
    out[k, 9] = heat
    out[k, 10] = x[2]
    out[k, 11] = water
    out[k, 12] = 0.5 * (x[0] + x[1])


@njit(cache=True)
def advance(
    t,
    end,
    T,
    w,
    x,
    p,
    layout,
    base,
    cap,
    volume,
    latent,
    skin,
    wet,
    start,
    step,
    low,
    high,
    tolerance,
    longest,
    out,
    k,
):
    """Integrate from `t` to `end` (no jump between them), changing T, w, x in place.

    Rows are added to `out` from `k` on, the first one at `t` itself; returns the next free row,
    or -1 where `out` is full.
    """
    nb, p0, p1, n = layout[0], layout[1], layout[2], T.size
    m = p1 - p0
    top = p1 + n - nb - p1
    middle = 0.5 * (t + end)
    present = p[INSERTED] < middle < p[REMOVED]
    g, loss = np.empty(n + 1), np.empty(n)
    uT, uw, ux = np.zeros((4, n)), np.zeros((4, m)), np.zeros((4, 5))
    yT, yw, yx = np.empty(n), np.empty(m), np.empty(5)
    fT, fw, fx = np.empty(n), np.empty(m), np.empty(5)
    tT, tw, tx = np.empty(n), np.empty(m), np.empty(5)
    zT, zw, zx = np.empty(n), np.empty(m), np.empty(5)
    g2, loss2 = np.empty(n + 1), np.empty(n)
    gT, gw, cc = np.zeros(m), np.zeros(m), np.empty(n)
    ratio, pivot, up, lo = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    moist = latent[0] > 0.0 and present
    f = closed_fraction(t, p) if present else 0.0
    record(t, T, w, x, f, p, layout, cap, latent, out, k)
    k += 1
    h = min(1e-3, end - t)
    while t < end - 1e-9:
        if k >= out.shape[0]:
            return -1
        if t + 1.01 * h > end:
            h = end - t
        f0 = slope(
            t,
            middle,
            T,
            w,
            x,
            p,
            layout,
            base,
            cap,
            volume,
            latent,
            skin,
            wet,
            start,
            step,
            low,
            high,
            g,
            loss,
            fT,
            fw,
            fx,
        )
        eps = 1e-3 * h
        slope(
            t + eps,
            middle,
            T,
            w,
            x,
            p,
            layout,
            base,
            cap,
            volume,
            latent,
            skin,
            wet,
            start,
            step,
            low,
            high,
            g2,
            loss2,
            tT,
            tw,
            tx,
        )
        for i in range(n):
            tT[i] = (tT[i] - fT[i]) / eps
        for j in range(5):
            tx[j] = (tx[j] - fx[j]) / eps
        inv = 1.0 / (GAMMA * h)
        for i in range(n):
            cc[i] = cap[i]
        for i in range(p0, p1):
            cc[i] *= 1.0 + p[C_SLOPE] * (T[i] - 20.0)
        # matrix 1/(γh) - J, factored once a step
        for i in range(n):
            lo[i] = -g[i] / cc[i] if i > 0 else 0.0
            up[i] = -g[i + 1] / cc[i] if i < n - 1 else 0.0
            pivot[i] = inv + (g[i] + g[i + 1] + loss[i]) / cc[i]
        if present and p[EDGE] > 0.0:
            for i in range(m):
                pivot[p0 + i] += p[EDGE] * volume[i] / cc[p0 + i]
        if moist:
            for i in range(m):
                _, gT[i], gw[i] = drying(T[p0 + i], w[i], p)
                pivot[p0 + i] -= latent[i] / cc[p0 + i] * gT[i] * inv / (inv - gw[i])
        for i in range(1, n):
            ratio[i] = lo[i] / pivot[i - 1]
            pivot[i] -= ratio[i] * up[i - 1]
        mix = p[FOOTPRINT] * f0
        for s in range(4):
            if s == 0:
                zT[:], zw[:], zx[:] = fT, fw, fx
            else:
                for i in range(n):
                    v = T[i]
                    for j in range(s):
                        v += A_U[s, j] * uT[j, i]
                    yT[i] = v
                for i in range(m):
                    v = w[i]
                    if moist:
                        for j in range(s):
                            v += A_U[s, j] * uw[j, i]
                    yw[i] = v
                for i in range(5):
                    v = x[i]
                    for j in range(s):
                        v += A_U[s, j] * ux[j, i]
                    yx[i] = v
                slope(
                    t + T_STAGE[s] * h,
                    middle,
                    yT,
                    yw,
                    yx,
                    p,
                    layout,
                    base,
                    cap,
                    volume,
                    latent,
                    skin,
                    wet,
                    start,
                    step,
                    low,
                    high,
                    g2,
                    loss2,
                    zT,
                    zw,
                    zx,
                )
            for i in range(n):
                v = zT[i] + G_STAGE[s] * h * tT[i]
                for j in range(s):
                    v += C_U[s, j] / h * uT[j, i]
                zT[i] = v
            if moist:
                for i in range(m):
                    v = zw[i]
                    for j in range(s):
                        v += C_U[s, j] / h * uw[j, i]
                    zw[i] = v
                    zT[p0 + i] += latent[i] / cc[p0 + i] * gw[i] * v / (inv - gw[i])
            for i in range(1, n):
                zT[i] -= ratio[i] * zT[i - 1]
            uT[s, n - 1] = zT[n - 1] / pivot[n - 1]
            for i in range(n - 2, -1, -1):
                uT[s, i] = (zT[i] - up[i] * uT[s, i + 1]) / pivot[i]
            if moist:
                for i in range(m):
                    uw[s, i] = (zw[i] + gT[i] * uT[s, p0 + i]) / (inv - gw[i])
            for j in range(5):
                v = zx[j] + G_STAGE[s] * h * tx[j]
                for q in range(s):
                    v += C_U[s, q] / h * ux[q, j]
                if j >= 3 and p[LAG] > 0.0:
                    face = uT[s, p0] if j == 3 else uT[s, p1 - 1]
                    plate = uT[s, nb - 1] if j == 3 else uT[s, top]
                    v = (v + ((1.0 - mix) * face + mix * plate) / p[LAG]) / (inv + 1.0 / p[LAG])
                elif j < 2 and p[CURE_HEAT] > 0.0 and present:
                    face = T[p0] if j == 0 else T[p1 - 1]
                    k_cure = p[CURE_RATE] * np.exp(-p[CURE_KELVIN] * (1.0 / (face + 273.15) - 1.0 / 423.15))
                    v /= inv + k_cure
                else:
                    v /= inv
                ux[s, j] = v
        worst = 0.0
        for i in range(n):
            e = 0.0
            for j in range(4):
                e += E_U[j] * uT[j, i]
            worst = max(worst, abs(e))
        if moist:
            for i in range(m):
                e = 0.0
                for j in range(4):
                    e += E_U[j] * uw[j, i]
                worst = max(worst, abs(e) * 5.0)
        for j in range(3, 5):
            e = 0.0
            for q in range(4):
                e += E_U[q] * ux[q, j]
            worst = max(worst, abs(e))
        worst /= tolerance
        if worst > 1.0 and h > 1e-6:
            h *= max(0.2, 0.85 * worst ** (-1.0 / 3.0))
            continue
        t += h
        for i in range(n):
            for j in range(4):
                T[i] += M_U[j] * uT[j, i]
        if moist:
            for i in range(m):
                for j in range(4):
                    w[i] += M_U[j] * uw[j, i]
        for i in range(5):
            for j in range(4):
                x[i] += M_U[j] * ux[j, i]
        f = closed_fraction(min(t, end), p) if present else 0.0
        record(t, T, w, x, f, p, layout, cap, latent, out, k)
        k += 1
        h *= min(2.5, 0.85 * max(worst, 1e-4) ** (-1.0 / 3.0))
        h = min(h, longest)
    return k
