"""A test in one line, for tables and figures."""

from seft_ros.recording.record import Record


def title_of(record: Record) -> str:
    """Name method, mass ratio, compensation and rate of a test."""
    section = record.experiment.sections.get("reference_force", {})
    parts = [str(section.get("method", "test")).upper()]
    if "mass_ratio" in section:
        parts.append(f"mass ratio {section['mass_ratio']:g}")
    if "compensation.method" in section:
        parts.append(f"compensation {section['compensation.method']}")
    parts.append(f"{record.experiment.timebase.rate:g} Hz")
    return ", ".join(parts)
