"""A client generated from the API's own description, in an environment of its own, reads and changes."""

import subprocess
import sys
import venv

import pytest

USE = """
import sys
sys.path.insert(0, sys.argv[1])
from kerntemp_client import AuthenticatedClient, Client, models
from kerntemp_client.api.model import list_coefficients, list_diagnoses, list_drift, list_models
from kerntemp_client.api.press import list_channels, list_presses
from kerntemp_client.api.runs import change_run, get_estimates, get_fit, get_run, get_samples
from kerntemp_client.api.runs import get_simulation, list_runs
from kerntemp_client.api.system import get_health, list_events

client = Client(base_url=sys.argv[2])
model = (list_coefficients, list_drift, list_models, list_diagnoses)
for one in (list_runs, list_presses, list_channels, *model, list_events):
    print(type(one.sync(client=client)).__name__)
for one in (get_run, get_samples, get_estimates, get_fit, get_simulation):
    print(type(one.sync("lab-2026-03-04-01", client=client)).__name__)
print(get_health.sync(client=client).version)
print(get_run.sync("nothing", client=client).detail)
changes = models.RunChanges(remark="by a generated client")
print(change_run.sync("lab-2026-03-04-01", client=client, body=changes).status)
writer = AuthenticatedClient(base_url=sys.argv[2], token=sys.argv[3])
print(change_run.sync("lab-2026-03-04-01", client=writer, body=changes).remark)
"""
ANSWERS = [
    *(
        "RunList",
        "PressList",
        "ChannelList",
        "CoefficientHistory",
        "DriftList",
        "ModelList",
        "DiagnosisList",
        "EventList",
    ),
    *("RunDetail", "Samples", "Estimates", "Fit", "SimulatedRun"),
]


@pytest.mark.campaign
def test_a_generated_client_reads_every_list_and_changes_a_run(serve, tokens, tmp_path):
    base = serve()
    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv" / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    install = [python, "-m", "pip", "install", "--quiet", "openapi-python-client>=0.26,<1"]
    subprocess.run(install, check=True, capture_output=True)
    generate = [python, "-m", "openapi_python_client", "generate", "--url", f"{base}/api/v1/openapi.json"]
    subprocess.run([*generate, "--output-path", tmp_path / "client"], check=True, capture_output=True)
    token = tokens.create("generated", "write")
    used = [python, "-c", USE, tmp_path / "client", base, token]
    done = subprocess.run(used, check=True, capture_output=True, text=True)
    output = done.stdout.splitlines()
    assert output[: len(ANSWERS)] == ANSWERS
    assert "does not exist" in output[-3]
    assert output[-2:] == ["401", "by a generated client"]
