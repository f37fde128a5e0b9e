"""What the API says, one class per answer. Units stand in field names, instants are UTC, missing is null."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from typing import Annotated, Any, Generic, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from daq.store.records import Page

T = TypeVar("T")
R = TypeVar("R")
State = Literal["idle", "open", "closed", "unknown"]
Verdict = Literal["good", "blister", "undercured", "scrap"]


class _Answer(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Paged(_Answer, Generic[T]):
    """One page of a list."""

    items: list[T]
    next_cursor: str | None

    @classmethod
    def of(cls, page: Page[R], shown: Callable[[R], T]) -> Self:
        """Return a page of the store as the API shows its rows."""
        return cls(items=[shown(row) for row in page.items], next_cursor=page.next_cursor)


class Whole(_Answer, Generic[T]):
    """A list that comes in one piece."""

    items: list[T]
    next_cursor: str | None = None


class Said(_Answer):
    """A message without its words: `/messages/{language}` has what its code says, with these arguments in it."""

    code: str
    arguments: dict[str, Any] = Field(default_factory=dict)
    """Texts, numbers, lists of them, and messages again."""


class Messages(_Answer):
    """The words of all messages in one language."""

    language: str
    languages: list[str]
    """All there are words for, English first."""
    messages: dict[str, str]
    """What each code says, in the syntax of Project Fluent."""


class Problem(_Answer):
    """A problem document (RFC 9457): every error has this form."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str = ""
    detail_said: Said
    instance: str = ""


class ProcessHealth(_Answer):
    """One of the long-running processes, as its last heartbeat tells."""

    name: str
    alive: bool
    state: str
    message: str = ""
    message_said: list[Said] = Field(default_factory=list)
    """The same as messages; empty where a process of an older version speaks."""
    utc: datetime | None
    age_s: float | None
    details: dict[str, Any] = Field(default_factory=dict)


class ArchiveHealth(_Answer):
    """The archive of old runs' scans."""

    runs: int
    """Whose scans are there."""
    bytes: int
    unsound: int
    """Files found missing or damaged, each named in the journal."""
    pressings_only: int
    """Runs whose scans were given up by rule."""


class StoreHealth(_Answer):
    """The store: how big it is and how long the disk lasts."""

    kind: str
    size_bytes: int | None
    free_bytes: int | None
    hours_left: float | None = Field(description="At the present rate; null until 10 min and 16 MB were recorded.")
    archive: ArchiveHealth | None = Field(default=None, description="Null where `store.archive` is not set.")


class Health(_Answer):
    """Whether the system does its work."""

    status: Literal["ok", "degraded", "down"]
    version: str
    utc: datetime
    store: StoreHealth
    processes: list[ProcessHealth]
    alarms: list[str]
    alarms_said: list[Said]
    """The same, item by item."""


class Advice(_Answer):
    """When to open the press: the one answer everything else of the forecast goes with."""

    verdict: Literal[
        "open_now", "open_in", "too_early", "not_known", "no_target", "not_closed", "opened", "no_panel", "blocked"
    ]
    open_in_s: float | None = None
    """Until the core reaches the target by the heat in the panel, should it be taken out, or until every limit of
    the resin file holds; 0 for now."""
    open_earliest_s: float | None = None
    open_latest_s: float | None = None
    """Bounds of 95 %; null where they are not known, the latest also where it is now."""
    blocking: str | None = None
    """The limit of the resin file that stands most in the way, where none of the look ahead meets all of them."""
    target_C: float | None = None  # noqa: N815
    peak_C: float | None = None  # noqa: N815
    """Of the core after opening: once it is open, and where it is to be opened, if it is opened then; null where
    that is not known, as ahead of limits of a resin file."""
    age_s: float | None = None
    """How old the look ahead is on which this rests."""
    sentence: str
    sentence_said: Said


class AdviceNow(_Answer):
    """The advice for the panel in one press."""

    press: str
    run: str | None
    advice: Advice


class AdviceList(Whole[AdviceNow]):
    """The advice for every press."""


class ChannelNow(_Answer):
    """One channel: its last value and how its logger has behaved."""

    press: str
    name: str
    logger: str = ""
    unit: str = "°C"
    role: Literal["platen", "top", "bottom", "core", "other"] = "other"
    value: float | None = None
    """In `unit`: a pressure in its own, a limit switch as 0 or 1."""
    temperature_C: float | None = None  # noqa: N815
    """The same where it is a temperature."""
    quality: str = "missing"
    left_out_K: float | None = None  # noqa: N815
    """How far it reads above its neighbours, where live sensor or fit do not use it for that."""
    utc: datetime | None = None
    last_good_utc: datetime | None = None
    age_s: float | None = None
    gaps_last_hour: int = 0
    """Scans of the last hour in which it had no usable value."""
    counters: dict[str, int] = Field(default_factory=dict)


class ChannelList(Whole[ChannelNow]):
    """All channels of all presses."""


class EstimateNow(_Answer):
    """The core temperature the live sensor predicts; low and high bound 95 %.

    What rests on it (heat, profile, forecast, warning) is empty while it is not valid.
    """

    run: str | None
    number: int | None
    utc: datetime | None
    """Of its scan."""
    age_s: float | None = None
    """How long ago that was when this was told. Times foreseen count from `utc`; those of `advice` from now."""
    valid_until_utc: datetime | None = None
    """From when on nothing here is to be acted on, if nothing newer came: `open_now` counts as false then."""
    time_s: float | None
    state: str
    core_C: float | None  # noqa: N815
    core_sd_K: float | None  # noqa: N815
    core_low_C: float | None  # noqa: N815
    core_high_C: float | None  # noqa: N815
    valid: bool
    reason: str = ""
    """Why it is not valid: a code in plain words, empty where it is; the catalogues hold its words."""
    reason_arguments: dict[str, Any] = {}
    suspected: str = ""
    """The cause the readings point to, where one is likelier than none."""
    energy_kJ_m2: float | None = None  # noqa: N815
    """Heat in the panel beyond its start."""
    profile_C: list[float] | None = None  # noqa: N815
    """Temperatures at even heights from the lower to the upper face."""
    band_from: dict[str, float] | None = None
    """Share of the band's variance by what it comes from (`softsensor.live.budget.KINDS`)."""
    target_in_s: float | None = None
    """Until the core reaches `setting.core_target_C` if the press stays as it is."""
    target_earliest_s: float | None = None
    target_latest_s: float | None = None
    """Bounds of 95 %."""
    open_in_s: float | None = None
    """When to open so that the core just reaches the target by the heat that is in the panel then."""
    open_earliest_s: float | None = None
    open_latest_s: float | None = None
    """Bounds of 95 %."""
    peak_C: float | None = None  # noqa: N815
    """Highest core temperature still to come if the panel is taken out now."""
    limit_in_s: float | None = None
    """Until the core's upper bound passes `setting.core_limit_C`."""
    warning: str = ""
    warning_said: Said | None = None
    forecast_age_s: float | None = None
    """How old the look ahead is that all of the forecast rests on; its times count from now."""
    course: list[tuple[float, float, float, float]] | None = None
    """The core to come if the press stays closed: seconds from the look on, core, lower and upper bound.
    Only beside the first estimate after a look."""
    cure_top: float | None = None
    """Degree of cure of the paper at the upper face, 0 to 1; null without a resin file."""
    cure_bottom: float | None = None
    cure_low: float | None = None
    """Lower bound of 95 % of the face that may have cured less."""
    grade: Literal["", "undercured", "matt", "glossy"] = ""
    """What such a face is by the thresholds of the resin file's `[grades]`; empty without any."""
    steam_kPa: float | None = None  # noqa: N815
    """Partial pressure of steam in the panel, as if it were sealed; null where its moisture is not known."""
    steam_high_kPa: float | None = None  # noqa: N815
    """Upper bound of 95 %."""
    open_now: bool = False
    """Whether the press is closed and every limit of the resin file holds with the wanted probability: ready for a
    relay, false where anything is not known, not valid or further than 5 s from this computer's clock."""
    limited: bool | None = None
    """Whether the resin file has a limit: then limits alone say when to open, and no target of the core. Null
    without a resin file, and where a live sensor of an older version speaks."""
    limits_in_s: float | None = None
    """From when on every limit of the resin file holds, if the press stays closed."""
    limits_earliest_s: float | None = None
    limits_latest_s: float | None = None
    """Bounds of 95 % of when that will be known."""
    limits_likely_in_s: float | None = None
    """From when on that is likelier than not."""
    limits_blocking: str = ""
    """The limit that stands most in the way where that is not foreseen."""
    left_out: dict[str, float] = Field(default_factory=dict)
    """Channels that read something else than their neighbours and are not used, and by how much. [K]"""
    advice: Advice | None = None


class Faces(_Answer):
    """Median of the good sensors at each place."""

    platen_top_C: float | None  # noqa: N815
    platen_bottom_C: float | None  # noqa: N815
    top_C: float | None  # noqa: N815
    bottom_C: float | None  # noqa: N815


class LastCore(_Answer):
    """The core temperature of a press that is silent, as it was last known."""

    utc: datetime
    core_C: float  # noqa: N815
    core_low_C: float  # noqa: N815
    core_high_C: float  # noqa: N815
    """Bounds of 95 %."""


class Target(_Answer):
    """The core temperature this pressing is to reach, and when."""

    temperature_C: float  # noqa: N815
    reached: bool
    time_to_target_s: float | None
    """If the press stays as it is; null while it cannot be said."""


class Phase(_Answer):
    """The press was in one state from one moment of the run to another."""

    state: State
    from_s: float
    to_s: float | None


class PressNow(_Answer):
    """One press as it stands."""

    press: str
    state: State
    """As the recorder left it; unknown where its newest scan is further than 5 s from this computer's clock."""
    since_utc: datetime | None
    age_s: float | None
    """Since the newest scan."""
    silent_after_s: float
    """What is older than this is not of now."""
    run: str | None
    run_status: str | None
    time_s: float | None
    time_since_closing_s: float | None
    phases: list[Phase]
    channels: list[ChannelNow]
    faces: Faces
    estimate: EstimateNow | None
    last_core: LastCore | None
    """The core when readings ended; null while they come, and where it was not known then."""
    target: Target | None
    coefficients: dict[str, float]
    description: dict[str, Any]
    """The press file as the recorder used it."""


class PressList(Whole[PressNow]):
    """Every press the store knows."""


class RunSummary(_Answer):
    """One pressing in a list."""

    run: str
    press: str
    status: str
    started_utc: datetime | None
    ended_utc: datetime | None
    duration_s: float | None
    scans: int
    material: str
    thickness_mm: float | None
    platen_temperature_C: float | None  # noqa: N815
    closed_s: float | None
    opened_s: float | None
    rmse_K: float | None  # noqa: N815
    fitted: bool
    described: bool | None
    """Whether the model describes it; null without a fit."""
    verdict: Verdict | None
    """What became of the panel, as the operator saw it."""
    damage: str | None = None
    """Why the run cannot be read any more, and what to do; null: it can."""
    damage_said: Said | None = None


class RunVerdict(_Answer):
    """What became of a panel, who said so, and when."""

    run: str
    verdict: Verdict | None
    who: str | None
    utc: datetime | None


class NextPanelNow(_Answer):
    """What is said of the panels to come at a press; runs begin with it until it is changed."""

    press: str
    recipe: str
    header: dict[str, Any]
    """Header keys as in a run file; `panel.initial_temperature_C` is that of one panel and used once."""
    who: str | None
    utc: datetime | None
    recipes: dict[str, dict[str, Any]]
    """Header keys of the recipes there are, by name."""
    doubts: list[str] = Field(default_factory=list)
    """What is to be asked about the header: keys nobody knows, constants far from the material table."""
    doubts_said: list[Said] = Field(default_factory=list)


class RunHit(RunSummary):
    """One pressing among those looked for."""

    remark: str
    recipe: str
    numbers: dict[str, float | None]
    """Every number known of the run: of its header, `press_time_s`, `rmse_K`, `core_at_opening_C`, `core_peak_C`,
    `band_at_opening_K` (the width of the 95 % band), and the coefficients that it determines, by name [W/m²K]."""


class SearchList(Paged[RunHit]):
    """Runs looked for."""

    lacking: list[str]
    """Names of bounds that a run may have and none of those looked at has."""


class RunList(Paged[RunSummary]):
    """One page of runs, newest first."""


class RunEdit(_Answer):
    """One change somebody made to a run's remark or header."""

    utc: datetime
    who: str
    field: str
    before: Any = None
    after: Any = None


class RunDetail(RunSummary):
    """One pressing with everything known about it."""

    header: dict[str, Any]
    columns: list[str]
    phases: list[Phase]
    remark: str
    changes: list[RunEdit]
    """Oldest first."""
    doubts: list[str] = Field(default_factory=list)
    """What is to be asked about the header: keys nobody knows, constants far from the material table."""
    doubts_said: list[Said] = Field(default_factory=list)


class SampleQuality(_Answer):
    """Consecutive rows in which values of a column were not simply good."""

    column: str
    """``*`` stands for every column that has no span of its own then."""
    quality: str
    from_s: float
    to_s: float
    rows: int


class Samples(_Answer):
    """Temperatures of a run, column by column; decimated rows are recorded ones."""

    run: str
    rows: int
    decimated: bool
    time_s: list[float]
    columns: dict[str, list[float | None]]
    quality: list[SampleQuality]
    """Why values are missing, or simulated; of all rows, also where they are decimated."""


class UnreadRun(_Answer):
    """A pressing whose scans are missing in an answer."""

    run: str
    why: str
    why_said: Said


class Extremes(_Answer):
    """The lowest and the highest usable value of a channel in each step; null where there is none."""

    low: list[float | None]
    high: list[float | None]


class Scans(_Answer):
    """What a press recorded between two instants, in steps of equal length."""

    press: str
    from_utc: datetime
    to_utc: datetime
    step_s: float
    scans: list[int]
    """In each step: fewer where idle scans were thinned, none where nothing was recorded."""
    columns: dict[str, Extremes]
    unread: list[UnreadRun]
    """Archived pressings whose scans cannot be read."""


class Estimates(_Answer):
    """What the live sensor said during the run, scan by scan."""

    run: str
    rows: int
    decimated: bool
    time_s: list[float]
    state: list[str]
    core_C: list[float | None]  # noqa: N815
    core_sd_K: list[float | None]  # noqa: N815
    core_low_C: list[float | None]  # noqa: N815
    core_high_C: list[float | None]  # noqa: N815
    valid: list[bool]
    cure_low: list[float | None]
    """Lower bound of 95 % of the less cured face, 0 to 1; null without a resin file."""
    grade: list[str]
    """What that face surely was by the resin file's thresholds; empty without any."""
    steam_high_kPa: list[float | None]  # noqa: N815
    """Upper bound of 95 %; null without a resin file or the panel's moisture."""


class SimulatedRun(_Answer):
    """The run simulated from its platen temperatures with its fitted coefficients."""

    run: str
    model_version: str | None
    time_s: list[float]
    positions: dict[str, list[float | None]]
    """One curve for each sensor position of the press file, such as ``panel.top``. [°C]"""
    measured: dict[str, list[float | None]]
    """The mean of the good sensors at each position. [°C]"""
    core_C: list[float | None]  # noqa: N815
    rmse_K: dict[str, float]  # noqa: N815
    """The fit's `rmse_K` by position: all good channels, each one's constant offset removed."""
    profile_time_s: list[float]
    profile_depth_mm: list[float]
    profile_C: list[list[float]]  # noqa: N815
    """Temperature through the panel: one row for each time, one value for each depth."""
    boiling_C: float  # noqa: N815
    """Where water boils in the model."""
    profile_heat_kJ_m2: list[float]  # noqa: N815
    """Heat in the panel beyond its start at each of these times, water and reactions not counted."""


class MarkedPanel(_Answer):
    """A panel marked good or blistered, and its steam at opening as the live sensor had it."""

    run: str
    verdict: Verdict
    steam_kPa: float | None  # noqa: N815
    steam_high_kPa: float | None  # noqa: N815
    """Upper bound of 95 %; both null where it was not known."""


class Blisters(_Answer):
    """The steam that a press's panels bear, learned from the marked ones."""

    press: str
    panels: list[MarkedPanel]
    """The newest first, 300 at most."""
    marks: int
    """Those of them whose steam is known."""
    blistered: int
    stated_kPa: float  # noqa: N815
    """What was believed before: the resin file's limit, or 100 kPa within a factor of two."""
    steam_most_kPa: float  # noqa: N815
    """What half of the panels bear."""
    ci95_kPa: tuple[float, float]  # noqa: N815
    sd_kPa: float  # noqa: N815
    """How far a panel's own limit may be from it, what is not known of it included."""
    curve_kPa: list[float]  # noqa: N815
    chance: list[float]
    """That a panel blisters which is opened with so much steam."""
    sentences: list[str]
    sentences_said: list[Said]


class WhatIfSetting(_Answer):
    """What can be asked about a run."""

    value: float
    """As asked."""
    was: float
    lower: float
    upper: float
    """The least and the most it can be."""


Bounded = tuple[float | None, float | None, float | None]
"""Lower bound of 95 %, expected, upper bound; null where it is not known."""


class WhatIfOutcome(_Answer):
    """What the press would be opened with."""

    core_C: Bounded  # noqa: N815
    cure: Bounded
    """Of the less cured face, 0 to 1."""
    steam_kPa: Bounded  # noqa: N815
    grade: Literal["", "undercured", "matt", "glossy"]
    """What that face surely is by the resin file's thresholds."""


class WhatIfAnswer(_Answer):
    """A run with other settings: the same panel, in a band of 95 % of all that is not known of it."""

    run: str
    settings: dict[str, WhatIfSetting]
    time_s: list[float]
    closed_s: float | None
    opened_s: float | None
    core_C: list[float | None]  # noqa: N815
    core_low_C: list[float | None]  # noqa: N815
    core_high_C: list[float | None]  # noqa: N815
    cure: list[float | None]
    """Of the less cured face, 0 to 1; null without a resin file."""
    cure_low: list[float | None]
    steam_kPa: list[float | None]  # noqa: N815
    """As if the panel were sealed; null without its moisture."""
    steam_high_kPa: list[float | None]  # noqa: N815
    at_opening: WhatIfOutcome | None
    """Null where the press was not seen to open."""


class CoefficientFit(_Answer):
    """One heat transfer coefficient. [W/m²K]"""

    model_config = ConfigDict(extra="allow")

    value: float
    sd: float | None = None
    ci95: tuple[float | None, float | None] | None = None
    identifiable: bool | None = None
    reason: str | None = None
    """Why the run cannot tell it, and what would."""
    reason_said: Said | None = None


class Fit(_Answer):
    """The coefficients of one run, as `kerntemp fit --json` reports them."""

    model_config = ConfigDict(extra="allow")

    run: str
    converged: bool
    coefficients: dict[str, CoefficientFit]
    rmse_K: float | None = None  # noqa: N815
    rmse_closed_K: float | None = None  # noqa: N815
    initial_rmse_K: float | None = None  # noqa: N815
    rmse_still_K: float | None = None  # noqa: N815
    """As `rmse_K`, rows left out in which the press or the panel is being moved. [K]"""
    initial_rmse_still_K: float | None = None  # noqa: N815
    seconds: float | None = None
    closed_s: float | None = None
    opened_s: float | None = None
    warnings: list[str] = Field(default_factory=list)
    warnings_said: list[Said] = Field(default_factory=list)


class CoefficientPoint(_Answer):
    """One run's coefficients in the history."""

    run: str
    press: str
    utc: datetime | None
    coefficients: dict[str, CoefficientFit]
    rmse_K: float | None  # noqa: N815
    initial_rmse_K: float | None  # noqa: N815
    settings: dict[str, float]
    """The run's `setting.*` keys that are numbers."""


class CoefficientHistory(Paged[CoefficientPoint]):
    """Coefficients over time, newest first."""


class Drift(_Answer):
    """A coefficient that has left what is usual and has not come back."""

    press: str
    coefficient: str
    since_run: str
    """The first run of the new behaviour."""
    noticed_run: str
    factor: float
    """New level over the old one."""
    chart: Literal["jump", "creep"]
    sentence: str
    sentence_said: Said


class DriftList(Whole[Drift]):
    """Coefficients that drift; empty where all is as usual."""


class ModelSummary(_Answer):
    """A version of the model."""

    version: str
    press: str
    utc: datetime | None
    status: Literal["candidate", "promoted", "retired", "rejected"]
    current: bool
    effects: list[str]
    reason: str = ""
    reason_said: Said | None = None


class ModelList(Paged[ModelSummary]):
    """Model versions, newest first."""


class ModelDetail(ModelSummary):
    """A model version with its file."""

    model: dict[str, Any]


class ParameterWords(_Answer):
    """How people are told an effect's parameter: in words, times a factor, in a unit."""

    words: str
    words_said: Said
    factor: float
    unit: str
    unit_said: Said


class DiagnosisRecord(_Answer):
    """What the simulation gets wrong, as `kerntemp diagnose --json` reports it, and when it was found."""

    id: str
    press: str
    utc: datetime
    verdict: str
    diagnosis: dict[str, Any]
    parameters: dict[str, ParameterWords]
    """Of the named effects, by full name (`edge_loss.W_m3K`); an effect no longer installed is not there."""
    has_curves: bool
    """Whether `/diagnoses/{id}/curves` has something to draw."""


class DiagnosisCurves(_Answer):
    """A diagnosis as curves: temperatures [°C] and residuals, measured minus model [K]; missing is null."""

    id: str
    press: str
    curves: dict[str, Any]
    """`run` at `time_s` by place, its core, and residuals of all runs since closing (`campaign`)."""


class DiagnosisList(Paged[DiagnosisRecord]):
    """Diagnoses, newest first."""


class UnfittedRun(_Answer):
    """A run that a night could not fit, and why."""

    run: str
    why: str
    why_said: Said


class Night(_Answer):
    """What the nightly job did for one press in one night."""

    id: str
    press: str
    started_utc: datetime
    ended_utc: datetime
    seconds: float
    memory_bytes: int | None
    """The most memory the job held until then, null on Windows."""
    runs: int
    """Finished pressings stored."""
    new: int
    fitted: int
    not_fitted: int
    """Runs of any night that cannot be fitted as they are."""
    blind: int
    """Runs without panel sensors."""
    later: int
    """Older runs whose fits rest on effects or a press file of before; their turn comes in the next nights."""
    later_nights: int
    """So many nights these take, a share of them in each."""
    left_out: list[UnfittedRun]
    """What could not be fitted this night, the first 50."""
    verdict: str
    """Of the diagnosis, `not_asked` where the runs are those of the night before, `failed` where the press's night
    did not come to its end: then `reason` says why."""
    named: list[str]
    promoted: str
    """The version promoted, empty without one."""
    refused: str
    """The candidate that was not promoted, empty without one."""
    version: str
    """The model in force afterwards, empty where there is none."""
    reason: str
    reason_said: Said
    archived: int = 0
    """Runs whose scans were moved into the archive."""
    archived_bytes: int = 0
    """Size of their files."""
    freed_bytes: int = 0
    """Room in the store for new scans."""
    pressings_only: int = 0
    """Runs whose archived scans were given up by rule."""
    archive_later: int = 0
    """Runs due for the archive that are still in the store."""


class NightList(Paged[Night]):
    """Nights, newest first."""


class Alarm(_Answer):
    """What somebody should know: raised once, and it stands until it is over."""

    id: str
    press: str | None
    message: str
    message_said: Said
    raised_utc: datetime
    ended_utc: datetime | None
    stands: bool
    acknowledged_utc: datetime | None
    acknowledged_by: str | None


class AlarmList(Paged[Alarm]):
    """Alarms, newest first."""


Celsius = Annotated[float, Field(ge=-100.0, le=1000.0, allow_inf_nan=False)]


class AlarmLimits(BaseModel):
    """Limits of a press; null is none."""

    model_config = ConfigDict(extra="forbid")

    core_above_C: Celsius | None = Field(None, description="The core as predicted.")  # noqa: N815
    platen_above_C: Celsius | None = None  # noqa: N815
    platen_below_C: Celsius | None = None  # noqa: N815
    silence_s: Annotated[float, Field(ge=2.0, le=1e6)] | None = Field(None, description="No scan for so long.")
    drift_percent: Annotated[float, Field(ge=1.0, le=1e4)] | None = Field(
        None, description="A coefficient that has left what is usual, by this much at least."
    )
    verdict_unknown: bool = Field(False, description="The newest diagnosis leaves something unexplained.")


class AlarmThresholds(_Answer):
    """The limits of a press, who set them last and when."""

    press: str
    thresholds: AlarmLimits
    who: str | None
    utc: datetime | None


class AlarmThresholdsList(Whole[AlarmThresholds]):
    """The limits of every press."""


class EventRecord(_Answer):
    """A line of the journal: an alarm, a loss, a change of state, a change and who made it."""

    id: str
    utc: datetime | None
    """Null for what a press did at a time nobody knows, as in a file without a date."""
    level: Literal["info", "warning", "alarm"]
    process: str
    press: str | None
    run: str | None = None
    message: str
    message_said: Said
    details: dict[str, Any] = Field(default_factory=dict)


class EventList(Paged[EventRecord]):
    """Events, newest first."""
