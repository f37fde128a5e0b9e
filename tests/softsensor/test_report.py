"""Figures and the page: self-contained, repeatable, and saying what was found."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.words.message import Message, catalogue_of, languages, words
from softsensor.fitting.core import fitted_core
from softsensor.jobs.campaign import fit_campaign
from softsensor.report import fit_report_runs
from softsensor.report.diagnosis_figures import residual_figure, votes_figure, worst_run_figure
from softsensor.report.fit_figures import coefficients_figure, core_figure, fitted_run_figure, sheet, svg
from softsensor.report.fit_report import fit_report
from softsensor.report.page import typeset
from tests.curves import CURVES


@pytest.fixture(scope="module")
def pressed():
    """Three runs with what is true of them; the first has a thermocouple in its core."""
    plan = Plan(rate_hz=1.0, press_time_s=(20.0, 40.0), open_after_s=(30.0, 40.0))
    pairs = list(make_campaign(6, 3, plan=plan))
    run, truth = pairs[0]
    return [(replace(run, columns={**run.columns, "core_1": truth.core_C}), truth), *pairs[1:]]


@pytest.fixture(scope="module")
def campaign(pressed):
    return fit_campaign(parse_press(press_toml()), [run for run, _ in pressed])


def test_page_needs_nothing_from_elsewhere_and_names_every_run(campaign):
    page = fit_report(campaign)
    assert page.startswith("<!doctype html>")
    assert not re.search(r'(src|href)="https?:', page)
    assert "<script" not in page
    for fitted in campaign.runs:
        assert fitted.run in page
    for name in campaign.coefficients:
        assert name in page
    assert "W/m²K" in page


def test_a_page_in_german_says_nothing_of_its_own_in_english(campaign):
    page = fit_report(campaign, language="de")
    assert '<html lang="de">' in page
    assert "Angepasst an 3 Pressungen liegt das Modell" in page
    english = {c: text.strip() for c, text in catalogue_of("en").entries().items() if c.startswith("report-")}
    assert not [c for c, text in english.items() if "{" not in text and f">{text}<" in page]


@pytest.mark.parametrize("language", languages())
def test_a_legend_below_the_axes_ends_within_its_figure(language):
    causes = ("conductivity_temperature", "heat_capacity_temperature", "thermocouple_footprint")
    votes = [{"cause": cause, "gains": [1.0, 2.0]} for cause in causes]
    for figure in (votes_figure({**CURVES, "votes": votes}, language), worst_run_figure(CURVES, language)):
        svg(figure)
        (legend,) = figure.legends
        drawn = legend.get_window_extent()
        assert (drawn.x0 >= 0.0, drawn.x1 <= figure.bbox.width) == (True, True)


def test_the_legend_of_a_fit_says_which_coefficients_each_line_has(campaign):
    labels = fitted_run_figure(campaign.runs[0]).get_axes()[0].get_legend_handles_labels()[1]
    assert labels[:2] == ["model with the press file's guesses", "model with fitted coefficients"]


@pytest.mark.parametrize("language", languages())
def test_every_message_of_a_template_has_words(language):
    known = catalogue_of(language)
    templates = (Path(__file__).parents[2] / "softsensor/templates").glob("*.html")
    codes = {
        code
        for file in templates
        for code in re.findall(r"""say\(["']([a-z0-9_A-Z-]+)["']""", file.read_text("utf-8"))
    }
    assert codes
    assert not [code for code in sorted(codes) if not known.has(code)]


def test_same_campaign_gives_the_same_picture(campaign):
    assert svg(coefficients_figure(campaign)) == svg(coefficients_figure(campaign))


def test_figures_come_as_svg(campaign):
    assert "<svg" in svg(coefficients_figure(campaign))


@pytest.mark.parametrize("runs", [1, 3])
def test_every_run_of_a_few_has_its_tick_and_nothing_lies_between(campaign, runs):
    few = replace(campaign, runs=campaign.runs[:runs])
    axes = [ax for ax in coefficients_figure(few).axes if ax.axison]
    assert len(axes) == len(few.coefficients)
    for ax in axes:
        assert ax.get_xticks().tolist() == list(range(1, runs + 1))


def test_a_bootstrap_is_told_from_four_runs_on_and_digits_follow_the_interval(campaign):
    assert "bootstrap" not in fit_report(campaign)  # three runs
    name = next(name for name, c in campaign.coefficients.items() if c.runs == 3)
    wide = replace(campaign.coefficients[name], mean=643.27, ci95=(557.31, 729.23), runs=4)
    page = fit_report(replace(campaign, coefficients={**campaign.coefficients, name: wide}))
    assert "95\N{NO-BREAK SPACE}% (bootstrap)" in page
    assert re.search(f"<td[^>]*>{name}</td><td[^>]*><b>643</b></td>", page)
    assert ">557 – 729</td>" in page


def test_no_line_of_a_report_ends_between_a_number_and_its_unit(campaign):
    page = re.sub(r"<(style|svg)\b.*?</\1>", "", fit_report(campaign), flags=re.DOTALL)
    assert len(re.findall(r"\d\N{NO-BREAK SPACE}(?:K|s|%)(?!\w)", page)) > 20
    assert re.findall(r">[^<]*\d (?:K|s|%|°C|mm)(?!\w)[^<]*<", page) == []


def test_the_letters_of_every_picture_can_be_read_where_a_report_shows_it_narrowest(campaign):
    fitted = campaign.runs[0]
    pictures = [coefficients_figure(campaign), fitted_run_figure(fitted), core_figure(fitted, fitted_core(fitted))]
    pictures += [worst_run_figure(CURVES), residual_figure(CURVES), votes_figure(CURVES)]
    for picture in pictures:
        letters = [one for one in picture.findobj(Text) if one.get_text()]
        narrowest = 640 / (72 * picture.get_figwidth())  # pixels of the page for a point
        assert min(one.get_fontsize() for one in letters) * narrowest > 9


def test_a_numbers_minus_is_no_hyphen(campaign):
    page = fit_report(campaign, language="de")
    shown = re.sub(r"<(style|svg)\b.*?</\1>|<[^>]*>", " ", page, flags=re.DOTALL)
    assert "−0,1" in shown
    assert not re.findall(r"(?<![\w.-])-\d", shown)


def test_no_line_ends_between_a_number_and_its_sign():
    shown = typeset("2.7 K cooler (± 7.3 K from run to run), p = 0.0005, p < 0.0001; so p is small")
    assert shown.split(" ") == [
        *[
            "2.7\N{NO-BREAK SPACE}K",
            "cooler",
            "(±\N{NO-BREAK SPACE}7.3\N{NO-BREAK SPACE}K",
            "from",
            "run",
            "to",
            "run),",
        ],
        *[
            "p\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}0.0005,",
            "p\N{NO-BREAK SPACE}<\N{NO-BREAK SPACE}0.0001;",
            "so",
            "p",
            "is",
            "small",
        ],
    ]


def test_ink_shows_on_every_colour_of_the_correlations():
    for value in np.linspace(-1.0, 1.0, 41):
        cell = fit_report_runs._cell(value)
        tint = [int(c) for c in cell["colour"][4:-1].split(",")]
        light = fit_report_runs._luminance(tint)
        contrast = (light + 0.05) / 0.05 if cell["ink"] == "black" else 1.05 / (light + 0.05)
        assert contrast >= 4.5


@pytest.mark.parametrize(
    ("value", "says"), [(0.004, "0.00"), (-0.004, "0.00"), (0.0, "0.00"), (0.006, "+0.01"), (-0.006, "−0.01")]
)
def test_a_correlation_that_is_nought_to_its_digits_has_no_sign(value, says):
    assert words(fit_report_runs._cell(value)["text"], "en") == says


def test_the_true_core_is_within_the_fits_band_and_a_better_known_panel_makes_it_narrower(pressed, campaign):
    for fitted, (run, truth) in zip(campaign.runs, pressed, strict=True):
        found = fitted_core(fitted)
        known = np.isfinite(found.low)
        assert known.sum() > 60
        assert np.nanmedian(found.high + found.low - 2.0 * found.core) == pytest.approx(0.0, abs=1e-6)
        assert np.mean((truth.core_C >= found.low)[known] & (truth.core_C <= found.high)[known]) > 0.9
        start = min(run.header["panel.initial_temperature_C"], run.header["ambient.temperature_C"])
        assert np.nanmin(found.low) > start - 3.0
        assert np.isfinite(found.error_K) == ("core_1" in run.columns)
    run, _ = pressed[0]
    constants = campaign.runs[0].constants
    named = [key for key in constants if key in ("panel.conductivity_W_mK", "panel.heat_capacity_J_kgK")]
    stated = {key: constants[key].given for key in named} | {
        f"{key}.sd": 0.001 * constants[key].given for key in named
    }
    surer = fit_campaign(parse_press(press_toml()), [replace(run, header={**run.header, **stated})]).runs[0]
    sure, plain = (fitted_core(f) for f in (surer, campaign.runs[0]))
    assert np.nanmax(sure.high - sure.low) < 0.5 * np.nanmax(plain.high - plain.low)


@pytest.mark.parametrize("language", languages())
def test_the_page_draws_the_core_with_its_band_and_what_was_measured_there(campaign, language):
    say = catalogue_of(language).entries()
    figures = [core_figure(f, fitted_core(f), language) for f in campaign.runs]
    legends = [figure.axes[0].get_legend_handles_labels()[1] for figure in figures]
    own = [say[code].strip() for code in ("figure-core-band", "figure-core-by-fit", "figure-core-measured")]
    assert legends == [own, own[:2], own[:2]]
    page = fit_report(campaign, language=language)
    shown = [f for f in campaign.runs if svg(core_figure(f, fitted_core(f), language)) in page]
    assert len(shown) == 2  # the typical one and the worst
    assert say["report-legend-core"].strip() in page.replace("&#39;", "'").replace("\N{NO-BREAK SPACE}", " ")


def test_a_run_the_model_does_not_describe_has_no_core_to_believe(campaign):
    lost = replace(campaign.runs[0], misfit=Message("fit-misfit-span", {"rmse": 9.0, "span": 90.0}))
    assert fitted_core(lost) is None


@pytest.mark.parametrize(("language", "tick"), [("de", "0,5"), ("en", "0.5")])
def test_a_figure_has_the_decimal_sign_of_the_language_it_is_made_in(language, tick):
    with sheet((3.0, 2.0), language) as figure:
        ax = figure.subplots()
        ax.plot([0.0, 1.0], [0.0, 1.0])
        ax.yaxis.set_major_formatter("{x:g}")
    for axis in (ax.xaxis, ax.yaxis):
        assert axis.get_major_formatter().format_ticks([0.0, 0.5])[1] == tick
