import json
import os
import stat
import sys
import threading
import time
from pathlib import Path

import httpx
import pytest

from api.http.gate import SLOWED_S, is_loopback
from api.http.server import Listening, address_of
from api.http.tokens import ATTEMPTS, Attempts, TokenFile
from daq.records import InputError
from daq.tables import LARGEST_BYTES
from daq.words import spoken
from daq.words.message import words

PATIENT_S = 240.0
"""A busy machine answers late, and fails no test for it. [s]"""

PROMOTE = "/api/v1/models/2/promote"


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def test_a_change_needs_a_token_that_may_write(client, tokens, store):
    reader, writer = tokens.create("reader", "read"), tokens.create("writer", "write")
    assert client.post(PROMOTE).status_code == 401
    assert client.post(PROMOTE, headers=bearer(reader)).status_code == 403
    answer = client.post(PROMOTE, headers=bearer(writer))
    assert answer.json()["current"] is True
    assert store.active_model("lab").version == "2"
    assert answer.json()["reason"] == "extended"
    journal = [f"{entry.process} {entry.message!s} {entry.detail}" for entry in store.journal(limit=5).items]
    assert "writer" in journal[0]
    assert not any(writer in line for line in journal)


def test_a_wrong_token_is_refused_and_too_many_of_them_have_to_wait(serve):
    base = serve()
    for _ in range(ATTEMPTS):
        assert httpx.get(base + "/api/v1/runs", headers=bearer("kt_wrong"), timeout=PATIENT_S).status_code == 401
    answer = httpx.get(base + "/api/v1/runs", headers=bearer("kt_wrong"), timeout=PATIENT_S)
    assert answer.status_code == 429
    assert answer.headers["retry-after"] == "60"


def test_wrong_tokens_shut_nobody_out_who_has_a_valid_one(serve, tokens):
    base = serve()
    valid = tokens.create("tablet", "read")
    for i in range(ATTEMPTS):
        assert (
            httpx.get(base + "/api/v1/runs", headers=bearer(f"kt_guess{i}"), timeout=PATIENT_S).status_code == 401
        )
    asked = time.monotonic()
    assert httpx.get(base + "/api/v1/runs", headers=bearer("kt_guess"), timeout=PATIENT_S).status_code == 429
    assert time.monotonic() - asked >= SLOWED_S
    assert httpx.get(base + "/api/v1/runs", headers=bearer(valid), timeout=PATIENT_S).status_code == 200


@pytest.mark.parametrize(
    "damaged",
    [
        b"",
        b"\xff\xfe",
        b"null",
        b'["x"]',
        b'{"a": 1}',
        b'[{"id": "1", "name": "x"}]',
        b"[" * 100_000,
        b'[{"id": "1", "name": "x", "scope": "read", "sha256": 7, "created_utc": ""}]',
        '[{"id": "1", "name": "x", "scope": "read", "sha256": "é", "created_utc": ""}]'.encode(),
        b'[{"id": "1", "name": "x", "scope": "all", "sha256": "%s", "created_utc": ""}]' % (b"0" * 64),
    ],
)
def test_a_damaged_token_file_is_named_with_what_to_do(client, tokens, damaged, tmp_path):
    kept = tokens.path.read_bytes() if tokens.path.exists() else None
    tokens.path.write_bytes(damaged)
    try:
        answer = client.get("/api/v1/runs", headers=bearer("kt_any"))
        assert client.get("/api/v1/runs").status_code == 200, "reading on loopback needs no token"
    finally:
        tokens.path.unlink() if kept is None else tokens.path.write_bytes(kept)
    assert answer.status_code == 503
    assert answer.headers["content-type"] == "application/problem+json"
    detail = answer.json()["detail"]
    assert str(tokens.path) in detail
    assert "remove the file and make new ones" in detail
    own = TokenFile(tmp_path / "tokens.json")
    own.path.write_bytes(damaged)
    for command in (own.tokens, lambda: own.create("x", "read"), lambda: own.revoke("x")):
        with pytest.raises(InputError, match="remove the file and make new ones"):
            command()


def fill(path):
    with path.open("wb") as file:
        file.truncate(3_000_000_000)  # takes no room on the disk


@pytest.mark.skipif(sys.platform == "win32", reason="pipes and devices are files on POSIX")
@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero"), Path.mkdir, fill])
def test_what_is_no_file_of_tokens_holds_up_nobody(tmp_path, make):
    """A server that waits for a pipe, or reads without end, answers nobody any more."""
    own, found = TokenFile(tmp_path / "tokens.json"), []

    def ask():
        try:
            own.find("kt_any")
        except InputError as error:
            found.append(str(error))

    make(own.path)
    asking = threading.Thread(target=ask, daemon=True)
    asking.start()
    asking.join(240.0)
    assert ["remove the file and make new ones" in one for one in found] == [True]


def test_a_foreign_host_name_is_refused_so_that_no_other_page_reads_along(client):
    answer = client.get("/api/v1/runs", headers={"Host": "press.example.org"})
    assert answer.status_code == 403
    assert client.get("/api/v1/runs", headers={"Host": "localhost:1234"}).status_code == 200


def test_an_oversize_body_is_refused(client):
    answer = client.post(PROMOTE, content=b"x" * 100_000)
    assert answer.status_code == 413
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ('{"header": {"setting.x": ' + "7" * 5000 + "}}", ("setting.x", "5000 digits", "at most 4300")),
        ('{"remark": ' + "[" * 3000 + "]" * 3000 + "}", ("remark", "more than 16 deep")),
        ('{"remark": ' + '{"a":' * 3000 + "1" + "}" * 3001, ("more than 16 deep",)),
    ],
)
def test_a_body_nobody_can_read_is_refused_with_key_and_limit(client, body, says):
    answer = client.patch("/api/v1/runs/x", content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert not [part for part in says if part not in answer.json()["detail"]]


def test_digits_and_brackets_in_a_text_are_no_number_and_no_depth(client):
    for remark in ("7" * 5000, "[" * 3000, '\\"[' * 3000):
        answer = client.patch("/api/v1/runs/x", json={"remark": remark})
        assert "deep" not in answer.text
        assert "digits" not in answer.text
    body = '{"header": {"setting.x": 0.' + "7" * 5000 + "}}"
    answer = client.patch("/api/v1/runs/x", content=body, headers={"Content-Type": "application/json"})
    assert "digits" not in answer.text
    answer = client.patch("/api/v1/runs/x", content='"\\' * 20000, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422


def test_the_token_file_keeps_hashes_only_and_is_for_its_owner(tmp_path):
    file = TokenFile(tmp_path / "tokens.json")
    text = file.create("grafana", "read")
    kept = (tmp_path / "tokens.json").read_text()
    assert text.split("_", 2)[2] not in kept
    assert json.loads(kept)[0]["name"] == "grafana"
    if sys.platform != "win32":
        assert stat.S_IMODE((tmp_path / "tokens.json").stat().st_mode) == 0o600


def test_a_revoked_token_opens_nothing_any_more(tmp_path):
    file = TokenFile(tmp_path / "tokens.json")
    text = file.create("grafana", "read")
    found = TokenFile(tmp_path / "tokens.json").find(text)
    assert found is not None
    assert found.allows("read")
    assert not found.allows("write")
    file.revoke("grafana")
    assert file.find(text) is None
    with pytest.raises(InputError, match="does not exist"):
        file.revoke("grafana")


def test_two_tokens_of_one_name_are_refused(tmp_path):
    file = TokenFile(tmp_path / "tokens.json")
    file.create("grafana", "read")
    with pytest.raises(InputError, match="revoke it first"):
        file.create("grafana", "write")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (b"[\n\xff]", "Zeile 2: kein UTF-8-Text"),
        (b"[\n{", "unverständlich ab Zeile 2, Spalte 2"),
        (b"[3]", "aus fünf Texten"),
        (
            b'[{"id": "a", "name": "tablet", "scope": "", "sha256": "", "created_utc": ""}]',
            "Zugangstoken tablet",
        ),
        (b" " * (LARGEST_BYTES + 1), "keine Datei von Zugangstoken"),
    ],
)
def test_what_is_wrong_with_the_file_of_tokens_is_said_in_one_language(tmp_path, text, expected):
    (tmp_path / "tokens.json").write_bytes(text)
    with pytest.raises(InputError) as refused:
        TokenFile(tmp_path / "tokens.json").tokens()
    assert expected in words(spoken(refused.value), "de")


def test_waiting_a_minute_lets_an_address_try_again():
    now = [0.0]
    attempts = Attempts(now=lambda: now[0])
    for _ in range(ATTEMPTS):
        attempts.failed("10.0.0.9")
    assert attempts.exhausted("10.0.0.9")
    assert not attempts.exhausted("10.0.0.8")
    now[0] = 61.0
    assert not attempts.exhausted("10.0.0.9")


def test_beyond_loopback_the_server_listens_only_with_tokens(tmp_path):
    empty = TokenFile(tmp_path / "tokens.json")
    with pytest.raises(InputError, match="beyond loopback readers need tokens"):
        Listening(host="0.0.0.0").check(empty)
    empty.create("tablet", "read")
    Listening(host="0.0.0.0").check(empty)


def test_a_taken_port_is_told_in_one_line():
    with Listening(port=0).bind() as first:
        first.listen()
        port = first.getsockname()[1]
        assert address_of(first, tls=False) == f"http://127.0.0.1:{port}/"
        with pytest.raises(InputError, match=f"cannot listen on 127.0.0.1:{port}"):
            Listening(port=port).bind()


@pytest.mark.parametrize(
    ("address", "loopback"),
    [
        *((name, True) for name in ("127.0.0.1", "127.9.9.9", "::1", "[::1]", "localhost")),
        *((name, False) for name in ("0.0.0.0", "192.168.0.4", "localhost.example.org", "")),
    ],
)
def test_loopback_is_known_by_address(address, loopback):
    assert is_loopback(address) is loopback
