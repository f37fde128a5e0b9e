"""Hide a cause in the virtual press, let the diagnosis find it, and write its report.

    python deploy/examples/diagnosis/hidden_cause.py edge_loss report.html

Try `vapour_convection`, `thermocouple_lag`, or `contact_lapse`, which is in no catalogue. The run files of such a
campaign, for `kerntemp diagnose`, are written by `daq.simulated.campaign.write_campaign`.
"""

import sys
from pathlib import Path

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign, press_toml
from daq.words.message import sentences
from softsensor.diagnosis.summary import verdict_messages
from softsensor.diagnosis.verdict import diagnose
from softsensor.report.diagnosis_report import diagnosis_report


def main(cause: str, report: Path) -> None:
    """Diagnose twelve pressings with a hidden cause; a quarter of them carry a core thermocouple."""
    campaign = make_campaign(seed=7, n_runs=12, effects=cause, plan=Plan(core_column=0.25))
    found = diagnose(
        parse_press(press_toml()),
        [run for run, _ in campaign],
        progress=lambda what, share: sys.stderr.write(f"{100 * share:3.0f} %  {what}\n"),
    )
    report.write_text(diagnosis_report(found), encoding="utf-8")
    hidden = campaign[0][1].effects or campaign[0][1].outside
    sys.stdout.write(f"{found.verdict}: {sentences(verdict_messages(found))}\nhidden was {hidden}\n")


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
