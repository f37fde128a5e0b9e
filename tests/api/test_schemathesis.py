"""Schemathesis reads the API's own description and looks for answers that break it."""

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings


@pytest.mark.parametrize("method", ["GET", "POST"])
def test_no_generated_request_gets_an_answer_other_than_described(serve, method):
    schema = schemathesis.openapi.from_url(serve() + "/api/v1/openapi.json")
    tried = 0
    for found in schema.get_all_operations():
        operation = found.ok()
        if operation.method.upper() != method or operation.path.endswith("/live"):
            continue
        tried += 1

        @settings(
            max_examples=12,
            deadline=None,
            derandomize=True,
            database=None,
            phases=[Phase.explicit, Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(case=operation.as_strategy())
        def answers_as_described(case):
            case.call_and_validate(timeout=20)

        answers_as_described()
    assert tried >= 1
