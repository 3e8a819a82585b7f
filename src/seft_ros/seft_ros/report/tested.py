"""What was tested: configuration, motion, rig, software."""

from pathlib import Path
from typing import Any

import numpy as np
from seft_msgs_py.wire.topics import GROUND_MOTION

from seft_ros.page.content import Section, Table, Text
from seft_ros.recording.record import Record
from seft_ros.report.numbers import Findings

_SOFTWARE = ("python", "platform", "cpus")


def tested_section(findings: Findings) -> Section:
    """Tables of what was tested, and every parameter by node."""
    record = findings.record
    blocks = [
        Table((), _test_rows(findings), numbers=False),
        Table((), _software_rows(record.environment), numbers=False),
    ]
    return Section("What was tested", blocks)


def parameters_section(record: Record) -> Section:
    """Every parameter of every node, as resolved."""
    if not record.described:
        return Section("Parameters", [Text("The record does not hold the nodes' parameters.")])
    tables = [
        Table(
            (node, ""),
            [(name, _value(value)) for name, value in sorted(section.items())],
            numbers=False,
        )
        for node, section in sorted(record.experiment.sections.items())
    ]
    return Section("Parameters", tables)


def _test_rows(findings: Findings) -> list[tuple[str, str]]:
    record, summary = findings.record, findings.summary
    sections = record.experiment.sections
    force = sections.get("reference_force", {})
    rig = sections.get("rig")
    rows = [
        ("method", f"{force.get('method', 'unknown')}, mass ratio {_of(force, 'mass_ratio')}"),
        ("compensation", str(force.get("compensation.method", "unknown"))),
        ("ground motion", _motion(record)),
        ("largest ground acceleration", _largest_ground_acceleration(record)),
        ("axes", ", ".join(record.experiment.axes)),
        ("rate and steps", f"{summary['rate_hz']:g} Hz, {summary['steps']} steps"),
        ("duration", f"{summary['duration_s']:g} s{_pace(summary)}"),
    ]
    if rig is None:
        rows.append(("rig", "hardware, or one whose parameters are not recorded"))
    else:
        kind, specimen = _of(rig, "actuator.kind"), _of(rig, "specimen.kind")
        rows.append(("rig", f"simulated; actuator {kind}, specimen {specimen}"))
        rows += [
            (name, f"{_of(rig, f'specimen.{name}')} {unit}")
            for name, unit in (("mass", "kg"), ("damping", "N s/m"), ("stiffness", "N/m"))
        ]
    return rows


def _software_rows(environment: dict[str, Any]) -> list[tuple[str, str]]:
    git = environment.get("git") or {}
    dirty = " and changes" if git.get("dirty") else ""
    rows = [
        ("started", str(environment.get("start", "unknown"))),
        ("mode", str(environment.get("mode", "unknown"))),
        ("revision", f"{git['revision'][:12]}{dirty}" if git.get("revision") else "unknown"),
    ]
    rows += [(key, str(environment[key])) for key in _SOFTWARE if key in environment]
    versions = environment.get("versions") or {}
    return rows + [(name, str(version or "not installed")) for name, version in versions.items()]


def _motion(record: Record) -> str:
    section = record.experiment.sections.get("ground_motion", {})
    name = Path(section["file"]).name if section.get("file") else "synthetic"
    if not section:
        return "unknown"
    if not section.get("file"):
        name += f", seed {_of(section, 'synthetic.seed')}"
    if section.get("peak_force"):
        name += f", scaled to {section['peak_force']:g} N"
    if section.get("time_scale", 1.0) != 1.0:
        name += f", time scale {section['time_scale']:g}"
    return name


def _largest_ground_acceleration(record: Record) -> str:
    values = record.series[GROUND_MOTION.name].values
    return f"{np.abs(values).max():.4g} m/s²" if values.size else "unknown"


def _pace(summary: dict[str, Any]) -> str:
    if summary["realtime_factor"] is None:
        return ""
    return f", {summary['realtime_factor']:.3g} times real time"


def _of(section: Any, name: str) -> str:
    return _value(section[name]) if name in section else "unknown"


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(_value(item) for item in value) or "(none)"
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value) if value != "" else '""'
