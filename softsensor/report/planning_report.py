"""Pages that need no other file about what lies ahead: an advice, and a plan of the next pressings."""

from __future__ import annotations

from daq.words import say
from daq.words.message import ENGLISH
from softsensor.planning.advise import ProgrammeAdvice
from softsensor.planning.plan import PressingPlan
from softsensor.planning.summary import advice_messages, point_message, pressing_messages, standing_messages
from softsensor.report.advice_figure import advice_figure
from softsensor.report.fit_figures import svg
from softsensor.report.page import page
from softsensor.report.plan_figure import plan_figure

TEMPLATE = "planning_report.html"


def advice_report(found: ProgrammeAdvice, language: str = ENGLISH) -> str:
    """Return what the terminal shows of an advice, with its figure, as HTML text."""
    title, *lines = advice_messages(found)
    return page(TEMPLATE, language, title=title, lines=lines, figure=svg(advice_figure(found, language)))


def plan_report(found: PressingPlan, language: str = ENGLISH) -> str:
    """Return what the terminal shows of a plan, with its figure, as HTML text."""
    points = [(point_message(advice.point), list(pressing_messages(advice))) for advice in found.points]
    figure = svg(plan_figure(found, language)) if points else ""
    lines = list(standing_messages(found))
    return page(TEMPLATE, language, title=say("report-plan"), lines=lines, points=points, figure=figure)
