"""The press as it stands: state, channels, estimate, and the live stream."""

from __future__ import annotations

from datetime import timedelta
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request
from fastapi.responses import StreamingResponse

from api.answers.advice import advice_of
from api.answers.blisters import blisters_of
from api.answers.channels import channels_now
from api.answers.decimation import column_values
from api.answers.present import present_of
from api.answers.records import estimate_of, press_now, utc_now
from api.answers.schemas import AdviceList, AdviceNow, Blisters, ChannelList, Extremes, PressList, Scans, UnreadRun
from api.answers.words import message_answer
from api.http.live import EventStream, Hub
from api.http.problems import ProblemError, problem_responses
from api.http.routes.common import Instant, PressesDep, ResinsDep, StoreDep, existing_press, zoned
from daq.press.resin_file import read_resin
from daq.words import say

router = APIRouter(tags=["press"], responses=problem_responses())

LONGEST = timedelta(hours=25)
"""A day of the clock, with the hour it is set back."""


@router.get("/press", operation_id="list_presses", summary="Every press as it stands")
def list_presses(store: StoreDep, presses: PressesDep) -> PressList:
    """Return state, running pressing, channels, estimate and target of each press."""
    now = utc_now()
    return PressList(items=[press_now(store, name, text, now) for name, text in presses.items()])


@router.get("/advice", operation_id="list_advice", summary="When to open each press, and how sure that is")
def list_advice(store: StoreDep, presses: PressesDep) -> AdviceList:
    """Return when to open each press so that its panel holds the heat its core needs, or why nobody knows."""
    items, now = [], utc_now()
    for name in presses:
        present = present_of(store, name, now)
        run, estimate = present.run, estimate_of(present, present.run, now)
        advice = estimate.advice if estimate and estimate.advice else advice_of(None, None)
        items.append(AdviceNow(press=name, run=run.run if run else None, advice=advice))
    return AdviceList(items=items)


@router.get(
    "/blisters",
    operation_id="get_blisters",
    summary="The steam that a press's panels bear",
    responses=problem_responses(404),
)
def get_blisters(
    store: StoreDep, resins: ResinsDep, press: Annotated[str, Query(description="Of this press.", max_length=200)]
) -> Blisters:
    """Return what panels marked good or blistered say of the steam that panels bear, as the live sensor saw it."""
    existing_press(store, press)
    return blisters_of(store, press, read_resin(resins[press]) if press in resins else None)


@router.get("/channels", operation_id="list_channels", summary="Every channel and how its logger behaves")
def list_channels(store: StoreDep, presses: PressesDep) -> ChannelList:
    """Return the last value, its quality and the logger's counters of each channel."""
    now = utc_now()
    items = []
    for name in presses:
        present = present_of(store, name, now)
        estimate = estimate_of(present, present.run, now)
        left_out = estimate.left_out if estimate else {}
        items += channels_now(store, name, present.channels, present.scan, now, left_out)
    return ChannelList(items=items)


@router.get(
    "/scans",
    operation_id="get_scans",
    summary="What a press recorded between two instants, thinned",
    responses=problem_responses(404),
)
def get_scans(
    store: StoreDep,
    press: Annotated[str, Query(description="Of this press.", max_length=200)],
    since: Annotated[Instant, Query(alias="from", description="At or after this instant.")],
    until: Annotated[Instant, Query(alias="to", description="Before this instant, at most 25 h later.")],
    points: Annotated[int, Query(ge=1, le=2000, description="Steps the time is cut into.")] = 600,
) -> Scans:
    """Return each channel's lowest and highest value in steps of equal length: no peak is lost.

    In pressings and between them, also of archived pressings; a run's own scans, each as it was, are under
    `/runs/{run}/samples`.
    """
    existing_press(store, press)
    begin, end = zoned(since), zoned(until)
    if not timedelta(0) < end - begin <= LONGEST:
        raise ProblemError(422, say("api-scans-span", begin=begin.isoformat(), end=end.isoformat()))
    found = store.envelope(press, begin, end, points)
    columns = {
        name: Extremes(low=column_values(found.low[name]), high=column_values(found.high[name]))
        for name in sorted(found.low)
    }
    return Scans(
        press=press,
        from_utc=begin,
        to_utc=end,
        step_s=found.step_s,
        scans=found.scans.astype(int).tolist(),
        columns=columns,
        unread=[UnreadRun(run=run, why=str(why), why_said=message_answer(why)) for run, why in found.unread],
    )


@router.get(
    "/live",
    operation_id="follow_live",
    summary="Follow scans, estimates, press events, runs and fits",
    response_class=StreamingResponse,
    responses={
        200: {
            "description": "Server-Sent Events named `scan`, `estimate`, `press`, `run`, `fit`; data is JSON",
            "content": {"text/event-stream": {"schema": {"type": "string"}}},
        }
    },
)
async def follow_live(
    request: Request, last_event_id: Annotated[str, Header(max_length=2000)] = ""
) -> EventStream:
    """Stream events from now on; with `Last-Event-ID`, first those missed since.

    Missed are told all press events, of each press the newest 2000 scans and estimates, the newest 3 runs, and the
    20 newest fits. Of what was longer ago `/runs/{run}/samples`, `/runs/{run}/estimates` and `/coefficients` tell.
    """
    hub = request.app.state.hub
    if not isinstance(hub, Hub):
        raise TypeError("the application was made without a hub")
    listener = None if hub.full else await hub.join(last_event_id)
    if listener is None:
        raise ProblemError(503, say("api-too-many-listeners"), {"Retry-After": "10"})
    return EventStream(hub, listener)
