"""The arrays of one solve, put together from a case, parameter values and the effects' terms."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from daq.press.press_file import InitialKind
from daq.records import NoSteadyState
from daq.words import say
from softsensor.effects import Terms
from softsensor.effects.effect import Numbers
from softsensor.heat import first_profile, implicit_steps
from softsensor.heat.case import Case
from softsensor.heat.solve_request import SolveRequest


@dataclass(frozen=True)
class Build:
    """The arrays of one solve, ready for the compiled steps."""

    request: SolveRequest
    stack: implicit_steps.Stack
    tangents: implicit_steps.Tangents
    drive: implicit_steps.Drive
    start: implicit_steps.State
    nonlinear: bool

    @staticmethod
    def of(case: Case, request: SolveRequest, *, nonlinear: bool) -> Build:
        """Lay out a case; `nonlinear` where an effect is. Raises NoSteadyState."""
        layout, p = case.layout, -(-len(request.names) // 4) * 4
        stack = layout.stack(case.mesh, request.terms, request.values, case.ambient)
        tangents = layout.tangents(request.terms, request.d_terms, request.names, p)
        drive = _drive(case, request, p)
        start = _start(case, request, stack, tangents, drive)
        return Build(
            request, stack, tangents, drive, start, nonlinear or bool(len(stack.table_x)) or layout.radiates
        )

    def begun_at_rest(self, case: Case) -> Build:
        """Return the build with a start at rest between first readings, as its tangents are now."""
        start = _empty_state(case, self.request, self.width)
        conditions = first_profile.Conditions(self.request, self.stack, self.tangents, self.drive)
        first_profile.at_rest(case, conditions, start)
        _shift(start, self.request)
        return replace(self, start=_begun(start))

    @property
    def terms(self) -> Terms:
        """Of all effects together."""
        return self.request.terms

    @property
    def width(self) -> int:
        """Room for parameters in the tangent arrays: theirs, filled up to a multiple of four."""
        return int(self.start.s.shape[0])


def _drive(case: Case, request: SolveRequest, p: int) -> implicit_steps.Drive:
    names, contacts, sources = request.names, request.terms.closed_contact, request.terms.sources
    weight, d_weight = case.step_clock.shares(request.values, names, p)
    factor, (steps, first) = case.unchanged, case.unchanged.shape
    if contacts or sources:
        factor = np.hstack([factor, np.ones((steps, len(sources)))])
        for m, f in _factors(request.terms, first).items():
            factor[:, m] = f
    d_factor = np.zeros((*factor.shape, p))
    boundary, shift = case.boundary, request.boundary_shift
    if shift != (0.0, 0.0):
        boundary = boundary.copy()
        boundary[:, :, 0] += shift
    d_boundary = np.zeros((2, p))
    for i, name in enumerate(names):
        if name in request.d_terms:
            for m, f in _factors(request.d_terms[name], first).items():
                d_factor[:, m, i] = f
            d_boundary[:, i] = request.d_terms[name].boundary_offset
        if name in ("boundary_bottom_K", "boundary_top_K"):
            d_boundary[0 if "bottom" in name else 1, i] = 1.0
    d_boundary[~case.layout.measured] = 0.0
    return implicit_steps.Drive(case.h, weight, d_weight, factor, d_factor, boundary, d_boundary)


def _factors(terms: Terms, first: int) -> dict[int, Numbers | float]:
    """Return the factors in a drive's columns: of contacts, and from `first` on of sources."""
    return {**terms.closed_contact, **{first + k: source.course for k, source in enumerate(terms.sources)}}


def _start(
    case: Case,
    request: SolveRequest,
    stack: implicit_steps.Stack,
    tangents: implicit_steps.Tangents,
    drive: implicit_steps.Drive,
) -> implicit_steps.State:
    p = drive.d_boundary.shape[1]
    state = _empty_state(case, request, p)
    initial, panel = case.press.initial, case.layout.panel
    shift, names = request.values.get("initial_K", 0.0), request.names
    if initial.kind is InitialKind.STEADY:
        still, held = _at_rest(case, request, drive), _held(case, shift, names, p)
        cell = implicit_steps.rest(stack, tangents, still, held, state)
        if cell >= 0:
            _refuse_start(case, cell)
        state.t[~panel] += float(request.terms.plates_offset)
        for name, terms in request.d_terms.items():
            state.s[names.index(name), ~panel] += float(terms.plates_offset)
    else:
        if initial.kind is InitialKind.UNIFORM:
            state.t[:] = _uniform(case)
        else:
            first_profile.in_height(case, state)
        _shift(state, request)
    return _begun(state)


def _begun(state: implicit_steps.State) -> implicit_steps.State:
    """Return the state with its temperatures as those before, too."""
    state.t_before[:] = state.t
    state.s_before[:] = state.s
    return state


def _empty_state(case: Case, request: SolveRequest, p: int) -> implicit_steps.State:
    n, r, z = len(case.mesh.dx), len(request.terms.conversions), np.zeros
    return implicit_steps.State(z(n), z(n), z((r, n)), z((p, n)), z((p, n)), z((r, p, n)), z(1))


def _shift(state: implicit_steps.State, request: SolveRequest) -> None:
    """Shift everything by what the start is off."""
    state.t[:] += request.values.get("initial_K", 0.0)
    if "initial_K" in request.names:
        state.s[request.names.index("initial_K")] += 1.0


def _uniform(case: Case) -> float:
    """Return the temperature that everything starts at: the press file's, or the panel's own. [°C]"""
    if (given := case.press.initial.temperature_C) is not None:
        return given
    assert case.panel is not None, "the press file is refused without a layer from the run"  # noqa: S101
    return case.panel.initial_temperature


def _at_rest(case: Case, request: SolveRequest, drive: implicit_steps.Drive) -> implicit_steps.Drive:
    """One step at the first row's outside temperatures, before the panel comes."""
    factors, p = drive.d_factor.shape[1:]
    weight, outside = np.zeros((1, 3)), np.zeros((1, 2, 2))
    weight[0, 0 if case.panel is not None else (1 if case.press.has_states else 2)] = 1.0
    outside[0, :, 0] = case.outside[0] + request.boundary_shift
    one, unmoved = np.ones((1, factors)), np.zeros((1, factors, p))
    return implicit_steps.Drive(np.ones(1), weight, np.zeros((1, 3, p)), one, unmoved, outside, drive.d_boundary)


def _held(case: Case, shift: float, names: tuple[str, ...], p: int) -> implicit_steps.Held:
    """The panel at its initial temperature, shifted; without a panel all cells are free."""
    held, t, d_t = case.layout.panel, np.zeros(len(case.mesh.dx)), np.zeros((p, len(case.mesh.dx)))
    if case.panel is not None:
        t[held] = case.panel.initial_temperature + shift
        if "initial_K" in names:
            d_t[names.index("initial_K"), held] = 1.0
    return implicit_steps.Held(held, t, d_t)


def _refuse_start(case: Case, cell: int) -> None:
    """Say why there is no steady start: the cell is tied to nothing, or, beyond the last, nothing settles."""
    why = say("start-not-steady-steep")
    if cell < len(case.mesh.dx):
        layer = next(name for name in case.mesh.layer if cell in range(*case.mesh.cells(name).indices(cell + 1)))
        why = say("start-not-steady-untied", layer=layer)
        if case.panel is not None:
            why = say("start-not-steady-untied-without-panel", layer=layer)
    raise NoSteadyState(say("start-not-steady", run=case.run.source or case.run.name, why=why))
