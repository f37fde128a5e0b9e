#!/usr/bin/env python3
"""Kerntemp on a Debian press PC: install, update, roll back, uninstall, complete; one command each, as root.

    python3 kerntemp_setup.py install [kerntemp-1.0.0-py3-none-any.whl]
    python3 kerntemp_setup.py update kerntemp-1.1.0-py3-none-any.whl
    python3 kerntemp_setup.py rollback
    python3 kerntemp_setup.py uninstall
    python3 kerntemp_setup.py complete

Without a wheel, the one is built that belongs to the source tree this file lies in. Every version has a folder of
its own below /opt/kerntemp; `current` points at the one in force. The configuration in /etc/kerntemp and the data
in /var/lib/kerntemp are never overwritten and never removed. An update backs the store up and checks the copy
before anything changes; where the new version changes the store's schema, recording stops first, so that the
copy holds every scan, and rolling back brings that copy back (what was recorded since then is kept beside it).
Dask comes along where the configuration names a scheduler (`[refit] dask`); `complete` brings it to the version
in force where the configuration has come to name one since.

`--root DIR` does all of it below DIR and leaves the machine alone. KERNTEMP_LANGUAGE chooses the language,
as for `kerntemp`. This file needs nothing but Python.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

UNITS = ("kerntemp.target", "kerntemp-record.service", "kerntemp-sense.service", "kerntemp-serve.service")
RECORD = UNITS[1]
TIMER = "kerntemp-refit.timer"
PUBLISH = "kerntemp-publish.service"
EXTRAS = "plant,postgresql"
KEPT_VERSIONS = 3
HOME = Path(__file__).resolve().parent
Words = dict[str, str]
in_force: Words = {}
"""The pattern of each code it says, once `main` has found the catalogue."""


def find_words(place: Place, wheel: Path | None) -> Words:
    """Return what it says in KERNTEMP_LANGUAGE, else English: of its sources, the wheel, or what is installed."""
    here = [HOME.parent / "daq/words", *place.current.glob("lib/python*/site-packages/daq/words")]
    for language in (os.environ.get("KERNTEMP_LANGUAGE", ""), "en"):
        name = f"{language}.ftl"
        texts = [path.read_text(encoding="utf-8") for folder in here if (path := folder / name).is_file()]
        if wheel is not None and zipfile.is_zipfile(wheel):
            with zipfile.ZipFile(wheel) as archive:
                texts += [archive.read(n).decode() for n in archive.namelist() if n == f"daq/words/{name}"]
        for text in texts:
            if found := dict(re.findall(r"^(setup-[a-z-]+) = (.+)$", text, re.MULTILINE)):
                return found
    return {}


def words(code: str, **known: object) -> str:
    """Return what a code says; without a catalogue the code itself with its arguments."""
    if code not in in_force:
        return ": ".join([code, ", ".join(f"{name} = {value}" for name, value in known.items())]).rstrip(": ")
    return re.sub(r"\{ \$(\w+) \}", lambda found: str(known[found[1]]), in_force[code])


class Refused(Exception):
    """It cannot be done now; nothing was changed. The text says what to do."""


class Place:
    """The folders of one installation."""

    def __init__(self, root: Path, *, compiles: bool = True) -> None:
        self.root = root
        self.compiles = compiles
        self.code = root / "opt/kerntemp"
        self.current = self.code / "current"
        self.history_file = self.code / "history.json"
        self.settings = root / "etc/kerntemp"
        self.config = self.settings / "kerntemp.toml"
        self.data = root / "var/lib/kerntemp"
        self.cache = root / "var/cache/kerntemp"
        self.backups = self.data / "backups"
        self.units = root / "etc/systemd/system"
        self.rules = root / "etc/udev/rules.d/60-kerntemp.rules"
        self.users = root / "etc/sysusers.d/kerntemp.conf"
        self.command = root / "usr/local/bin/kerntemp"

    @property
    def live(self) -> bool:
        """Whether this is the running system and not a folder."""
        return self.root == Path("/") and Path("/run/systemd/system").is_dir()

    @property
    def history(self) -> list[dict[str, Any]]:
        """What was installed, oldest first; the last entry is in force."""
        return json.loads(self.history_file.read_text()) if self.history_file.exists() else []

    @property
    def extras(self) -> str:
        """What is installed beside the plain program; Dask where the configuration names a scheduler."""
        wanted = self.config.exists() and self._configured("refit", "dask")
        return f"{EXTRAS},dask" if wanted else EXTRAS

    def _configured(self, table: str, key: str) -> Any:
        try:
            return tomllib.loads(self.config.read_text()).get(table, {}).get(key, "")
        except (OSError, tomllib.TOMLDecodeError) as error:
            raise Refused(words("setup-config-unreadable", file=self.config, error=error)) from error

    def remember(self, history: list[dict[str, Any]]) -> None:
        """Keep the history."""
        draft = self.history_file.with_suffix(".new")
        draft.write_text(json.dumps(history, indent=1) + "\n")
        draft.replace(self.history_file)

    def shared(self, version: str) -> Path:
        """The files a version brings beside its code."""
        return self.code / version / "share/kerntemp"


def say(line: str) -> None:
    """Tell what is being done."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def run(*command: str | Path, **options: Any) -> str:
    """Run a command; raises `Refused` with its last line where it fails."""
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, check=False, **options)
    if done.returncode != 0:
        lines = [line for line in (done.stderr + done.stdout).splitlines() if line.strip()]
        why = lines[-1] if lines else f"status {done.returncode}"
        raise Refused(words("setup-command-failed", name=Path(command[0]).name, why=why))
    return done.stdout.strip()


def systemctl(place: Place, *request: str) -> None:
    """Ask systemd, on the running system only."""
    if place.live:
        run("systemctl", *request)


def as_service(place: Place, version: str, *command: str) -> str:
    """Run a program of a version as the service's user, with its home and caches."""
    line = [str(place.code / version / "bin" / command[0]), *command[1:]]
    own = {"NUMBA_CACHE_DIR": place.cache, "MPLCONFIGDIR": place.cache / "matplotlib", "HOME": place.data}
    environment = {name: str(path) for name, path in own.items()}
    if place.root == Path("/"):
        line = ["runuser", "-u", "kerntemp", "--", "env", *(f"{k}={v}" for k, v in environment.items()), *line]
    return run(*line, cwd=place.data, env={**os.environ, **environment})


# --- a version's code -----------------------------------------------------------------------------------


def version_of(wheel: Path) -> str:
    """Return the version a wheel says it is."""
    try:
        with zipfile.ZipFile(wheel) as archive:
            name = next(n for n in archive.namelist() if n.endswith(".dist-info/METADATA"))
            lines = archive.read(name).decode().splitlines()
    except (OSError, zipfile.BadZipFile, StopIteration) as error:
        raise Refused(words("setup-no-wheel", file=wheel)) from error
    metadata = dict(line.split(": ", 1) for line in lines if line.startswith(("Name: ", "Version: ")))
    if metadata.get("Name") != "kerntemp":
        raise Refused(words("setup-other-wheel", file=wheel, name=metadata.get("Name")))
    return metadata["Version"]


def make_environment(folder: Path) -> None:
    """Make an empty Python environment."""
    try:
        run(sys.executable, "-m", "venv", folder)
    except Refused as refused:
        raise Refused(words("setup-needs-venv", why=refused)) from refused


def built_wheel(folder: Path) -> Path:
    """Build the wheel of the source tree this file lies in."""
    source = HOME.parent
    if not (source / "pyproject.toml").is_file():
        raise Refused(words("setup-needs-wheel"))
    say(words("setup-building", folder=source))
    make_environment(folder / "builder")
    copied = folder / "source"
    shutil.copytree(source, copied, ignore=shutil.ignore_patterns(".*", "*.egg-info", "build", "__pycache__"))
    run(folder / "builder/bin/python", "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", folder, copied)
    return next(folder.glob("kerntemp-*.whl"))


def put_version(place: Place, wheel: Path, wheels: Path | None) -> str:
    """Install a version beside the others and try it; the ones that run do not notice.

    What a setup that failed has left of this version is made anew.
    """
    version = version_of(wheel)
    target = place.code / version
    if (target / "installed").exists() and version in {entry["version"] for entry in place.history}:
        raise Refused(words("setup-there-already", version=version, folder=target))
    shutil.rmtree(target, ignore_errors=True)
    say(words("setup-installing", version=version, folder=target))
    place.code.mkdir(parents=True, exist_ok=True)
    try:
        make_environment(target)
        put_packages(target, f"{wheel}[{place.extras}]", wheels)
        found = run(target / "bin/kerntemp", "--version")
        if version not in found:
            raise Refused(words("setup-other-version", found=found, version=version))
    except Refused:
        shutil.rmtree(target, ignore_errors=True)
        raise
    (target / "installed").write_text(datetime.now(UTC).isoformat() + "\n")
    return version


def put_packages(target: Path, what: str, wheels: Path | None) -> None:
    """Install into a version's environment, from the network or from a folder of wheels."""
    offline = ["--no-index", "--find-links", str(wheels)] if wheels else []
    run(target / "bin/python", "-m", "pip", "install", "--quiet", *offline, what)


def warm_up(place: Place, version: str) -> None:
    """Compile now what the first pressing would have to wait for."""
    if place.compiles:
        say(words("setup-compiling"))
        as_service(place, version, "python", "-m", "softsensor.jobs.first_start")


def schema_of(place: Place, version: str) -> int:
    """Return the store's schema a version works with."""
    question = "from daq.store.database import migrations; print(max(migrations()))"
    # Isolated: not what lies in the folder from which the setup was called.
    return int(run(place.code / version / "bin/python", "-I", "-c", question))


def store_file(place: Place, version: str) -> Path | None:
    """Return the file the services keep their store in, as a version reads the configuration; None: PostgreSQL."""
    question = (
        "import sys; from pathlib import Path; from daq.process.config import load_config; "
        "from daq.store.database import store_url; url = store_url(load_config(Path(sys.argv[1])).store.url); "
        "print(url.database if url.get_backend_name() == 'sqlite' else '')"
    )
    folder = as_service(place, version, "python", "-I", "-c", question, str(place.config))
    return place.data / folder if folder else None


def switch(place: Place, version: str) -> None:
    """Put a version in force: units, rules and command, then the link; on a full disk nothing of it."""
    shared = place.shared(version)
    new = {place.units / unit.name: unit.read_bytes() for unit in (shared / "systemd").iterdir()}
    new |= {place.rules: (shared / "udev/60-kerntemp.rules").read_bytes(), place.command: command_of(place)}
    drafts = {target: target.with_name(f".{target.name}.new") for target in (*new, place.current)}
    try:
        for target, content in new.items():
            target.parent.mkdir(parents=True, exist_ok=True)
            drafts[target].write_bytes(content)
        drafts[place.command].chmod(0o755)
        drafts[place.current].unlink(missing_ok=True)
        drafts[place.current].symlink_to(version)
    except OSError:
        for draft in drafts.values():
            draft.unlink(missing_ok=True)
        raise
    for target, draft in drafts.items():
        draft.replace(target)
    systemctl(place, "daemon-reload")
    if place.live:
        run("udevadm", "control", "--reload")


def command_of(place: Place) -> bytes:
    """Return the command `kerntemp`: as the service's user where root calls, with the service's configuration."""
    return (
        "#!/bin/sh\n"
        "# Kerntemp of this press PC: its version in force, its configuration, its user.\n"
        f'export KERNTEMP_CONFIG="${{KERNTEMP_CONFIG:-{place.config}}}"\n'
        f'export NUMBA_CACHE_DIR="{place.cache}" MPLCONFIGDIR="{place.cache}/matplotlib"\n'
        'if [ "$(id -u)" = 0 ] && id kerntemp >/dev/null 2>&1; then\n'
        f'    HOME="{place.data}" exec runuser -u kerntemp -- {place.current}/bin/kerntemp "$@"\n'
        "fi\n"
        f'exec {place.current}/bin/kerntemp "$@"\n'
    ).encode()


# --- the machine ----------------------------------------------------------------------------------------


def make_user(place: Place, version: str) -> int | None:
    """Make the services' user; return its number where the user database is at hand."""
    place.users.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(place.shared(version) / "sysusers/kerntemp.conf", place.users)
    run("systemd-sysusers", f"--root={place.root}", place.users.name)
    entries = (place.root / "etc/passwd").read_text().splitlines()
    return next((int(line.split(":")[2]) for line in entries if line.startswith("kerntemp:")), None)


def make_folders(place: Place, version: str, user: int | None) -> None:
    """Make configuration and data folders; what is there stays as it is."""
    for folder in (place.settings, place.settings / "presses", place.data, place.backups, place.cache):
        folder.mkdir(parents=True, exist_ok=True)
    shared = place.shared(version)
    for press in (shared / "presses").iterdir():
        kept = place.settings / "presses" / press.name
        if not kept.exists():
            shutil.copyfile(press, kept)
    if not place.config.exists():
        place.config.write_text(first_configuration((shared / "kerntemp.toml").read_text(), place.data))
    for path in (place.settings, *place.settings.rglob("*")):
        hand_over(path, 0, user)
    for folder in (place.data, place.backups, place.cache):
        hand_over(folder, user, user)


def hand_over(path: Path, owner: int | None, group: int | None) -> None:
    """Let owner and group at a path and nobody else; who they are changes where the number is known and may."""
    path.chmod(0o750 if path.is_dir() else 0o640)
    if owner is not None and group is not None and os.geteuid() == 0:
        os.chown(path, owner, group)


def first_configuration(example: str, data: Path) -> str:
    """Return the example with all that services write where they may."""
    store, tokens = f'url = "{data}/kerntemp.sqlite"', f'tokens = "{data}/kerntemp-tokens.json"'
    buffer = f'buffer = "{data}/kerntemp-buffer.sqlite"'
    example = example.replace('url = "kerntemp.sqlite"', f"{store}\n{buffer}\n#", 1)
    example = example.replace('reports = "reports"', f'reports = "{data}/reports"', 1)
    return example.replace("[server]\n", f"[server]\n{tokens}\n", 1)


def back_up(place: Place, version: str, why: str) -> str:
    """Copy the store with a version's own program, which checks the copy; empty where there is none yet."""
    target = place.backups / f"{why}-{datetime.now(UTC):%Y-%m-%dT%H%M%S}.sqlite"
    store = store_file(place, version)
    if store is not None and not store.exists():
        return ""
    say(as_service(place, version, "kerntemp", "backup", str(target), "--config", str(place.config)))
    return str(target)


# --- the commands ----------------------------------------------------------------------------------------


def install(place: Place, wheel: Path | None, wheels: Path | None) -> None:
    """Install for the first time."""
    if place.history:
        raise Refused(words("setup-use-update", version=place.history[-1]["version"]))
    with tempfile.TemporaryDirectory(prefix="kerntemp-") as folder:
        version = put_version(place, wheel or built_wheel(Path(folder)), wheels)
    make_folders(place, version, make_user(place, version))
    switch(place, version)
    warm_up(place, version)
    place.remember([{"version": version, "schema": schema_of(place, version), "backup": ""}])
    systemctl(place, "enable", "--quiet", "kerntemp.target", TIMER)
    say(words("setup-installed", version=version))
    say(words("setup-next", file=place.config))


def update(place: Place, wheel: Path | None, wheels: Path | None) -> None:
    """Put a newer version in force; the one before stays for `rollback`."""
    history = place.history
    if not history:
        raise Refused(words("setup-use-install"))
    old = history[-1]["version"]
    with tempfile.TemporaryDirectory(prefix="kerntemp-") as folder:
        version = put_version(place, wheel or built_wheel(Path(folder)), wheels)
    warm_up(place, version)
    schema = schema_of(place, version)
    migrates = schema != history[-1]["schema"]
    store_file(place, version)  # reads the whole configuration: what the new version refuses in it stops nothing
    if migrates:
        say(words("setup-schema-changes", before=history[-1]["schema"], after=schema))
        systemctl(place, "stop", "kerntemp.target")
    backup = ""
    try:
        backup = back_up(place, old if migrates else version, f"before-{version}")
        say(as_service(place, version, "kerntemp", "check", "--offline", "--config", str(place.config)))
        switch(place, version)
        place.remember([*history, {"version": version, "schema": schema, "backup": backup}])
    except (Refused, OSError):
        undo(place, old, version, backup if migrates else "")
        raise
    restart(place, words("setup-update-partly", version=version, old=old))
    drop_old_versions(place)
    say(words("setup-updated", version=version, old=old))


def undo(place: Place, version: str, newer: str, backup: str) -> None:
    """Let the version before an update that failed run again, with its store where a copy is given."""
    try:
        if backup:
            restore(place, version, backup, newer)
    except Refused as refused:  # the update's own failure is the news
        say(words("setup-store-still-newer", version=newer, why=refused))
    try:
        if place.current.readlink() != Path(version):
            switch(place, version)
    finally:
        shutil.rmtree(place.code / newer, ignore_errors=True)
        systemctl(place, "restart", "kerntemp.target")


def rollback(place: Place) -> None:
    """Go back to the version before, with its store where the schema has changed since."""
    history = place.history
    if len(history) < 2:
        raise Refused(words("setup-nothing-before"))
    before, now = history[-2], history[-1]
    if not (place.code / before["version"] / "installed").exists():
        raise Refused(words("setup-version-gone", version=before["version"], folder=place.code))
    migrated = before["schema"] != now["schema"]
    if migrated and now["backup"]:
        say(as_service(place, before["version"], "kerntemp", "backup", now["backup"], "--verify"))
    systemctl(place, "stop", "kerntemp.target")
    try:
        if migrated:
            restore(place, before["version"], now["backup"], now["version"])
        switch(place, before["version"])
    except (Refused, OSError):
        systemctl(place, "start", "kerntemp.target")
        raise
    place.remember(history[:-1])
    shutil.rmtree(place.code / now["version"], ignore_errors=True)
    restart(place, words("setup-rollback-partly", version=before["version"]))
    say(words("setup-rolled-back", version=before["version"]))


def complete(place: Place, wheels: Path | None) -> None:
    """Bring to the version in force what the configuration has come to ask for."""
    history = place.history
    if not history:
        raise Refused(words("setup-use-install"))
    version = history[-1]["version"]
    put_packages(place.code / version, f"kerntemp[{place.extras}]=={version}", wheels)
    say(words("setup-complete", version=version, file=place.config, extras=place.extras))


def restore(place: Place, version: str, backup: str, newer: str) -> None:
    """Put the store of before the update back, none where there was none; the newer one is kept beside it.

    Raises `Refused` before anything has changed.
    """
    store = store_file(place, version)
    command = ["kerntemp", "backup", backup, "--restore"]
    if store is None:
        say(words("setup-restore-postgresql"))
        say(as_service(place, version, *command, "--config", str(place.config)))
        return
    draft = store.with_name(f"{store.name}.restored")
    move(draft, None)
    if backup:
        try:
            say(as_service(place, version, *command, "--store", str(draft)))
        except Refused:
            move(draft, None)
            raise
    kept = store.parent / f"kerntemp-{newer}-{datetime.now(UTC):%Y-%m-%dT%H%M%S}.sqlite"
    move(store, kept)
    move(draft, store)
    say(words("setup-kept-newer", version=newer, file=kept))


def move(store: Path, target: Path | None) -> None:
    """Rename an SQLite file, where it is there, with what belongs to it; None removes it."""
    for ending in ("", "-wal", "-shm"):
        path = store.with_name(store.name + ending)
        if target is None:
            path.unlink(missing_ok=True)
        elif path.exists():
            path.rename(target.with_name(target.name + ending))


def restart(place: Place, otherwise: str) -> None:
    """Start what belongs to the target anew; where that fails, say `otherwise` how things stand.

    The recorder goes first and alone: in one step with the others it would wait for the live sensor to stop. The
    target is started, for a restart of it would restart all that is part of it once more, a nightly job under way
    too. A service that fails keeps none of the others at the version before.
    """
    steps = [
        ("restart", RECORD),
        ("restart", *(unit for unit in UNITS[1:] if unit != RECORD), TIMER),
        ("start", "kerntemp.target"),
    ]
    publishes = ["systemctl", "is-enabled", "--quiet", PUBLISH]
    if place.live and subprocess.run(publishes, check=False).returncode == 0:
        steps.append(("restart", PUBLISH))
    refusals = []
    for step in steps:
        try:
            systemctl(place, *step)
        except Refused as refused:
            refusals.append(str(refused))
    if refusals:
        raise Refused(f"{otherwise}: {'; '.join(refusals)}")


def drop_old_versions(place: Place) -> None:
    """Keep the newest versions only."""
    kept = {entry["version"] for entry in place.history[-KEPT_VERSIONS:]}
    for folder in place.code.iterdir():
        if (folder / "installed").exists() and folder.name not in kept and not folder.is_symlink():
            shutil.rmtree(folder)


def uninstall(place: Place) -> None:
    """Remove the programs; configuration, drop-ins of the units and data stay."""
    if place.live:
        enabled = ("kerntemp.target", TIMER, PUBLISH)
        subprocess.run(["systemctl", "disable", "--now", "--quiet", *enabled], check=False)
        subprocess.run(["systemctl", "stop", "kerntemp-*"], check=False)
    for unit in (*place.units.glob("*.wants/kerntemp*"), *place.units.glob("kerntemp*")):
        if not unit.is_dir() or unit.is_symlink():
            unit.unlink()
    for folder in place.units.glob("kerntemp*.wants"):
        shutil.rmtree(folder)
    for path in (place.rules, place.users, place.command):
        path.unlink(missing_ok=True)
    shutil.rmtree(place.code, ignore_errors=True)
    shutil.rmtree(place.cache, ignore_errors=True)
    systemctl(place, "daemon-reload")
    say(words("setup-removed", settings=place.settings, data=place.data))


def main(arguments: Sequence[str] | None = None) -> int:
    """Do one of the commands."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=("install", "update", "rollback", "uninstall", "complete"))
    parser.add_argument("wheel", nargs="?", type=Path, help="kerntemp-VERSION-py3-none-any.whl")
    parser.add_argument("--wheels", type=Path, help="folder with all wheels, for a machine without a network")
    parser.add_argument("--no-warmup", action="store_true", help="let the first pressing wait for the compiler")
    parser.add_argument("--root", type=Path, default=Path("/"), help="work below this folder")
    given = parser.parse_args(arguments)
    place = Place(given.root.resolve(), compiles=not given.no_warmup)
    wheel = given.wheel.resolve() if given.wheel else None
    in_force.update(find_words(place, wheel))
    if os.geteuid() != 0:
        sys.stderr.write(f"kerntemp_setup: {words('setup-needs-root')}\n")
        return 2
    os.environ.pop("PYTHONPATH", None)  # the programs installed find their own code, not the caller's
    try:
        if given.action in ("install", "update"):
            {"install": install, "update": update}[given.action](place, wheel, given.wheels)
        elif given.action == "complete":
            complete(place, given.wheels)
        else:
            {"rollback": rollback, "uninstall": uninstall}[given.action](place)
    except (Refused, OSError) as refused:
        sys.stderr.write(f"kerntemp_setup: {refused}\n")
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
