"""What a multisine test has found of the channels: as parameters, and taken out of a recording."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.config.parameter_table import Section, per_axis
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import MEASURED, RIG_STATE, VALVE_COMMAND, of_one_rig
from seft_plant_sim import calibration
from seft_plant_sim.calibration import NOTHING_KNOWN, SIGNIFICANT, TILT, significant
from seft_plant_sim.channels import ACCELERATION, FORCE, VELOCITY, tilt_of, velocity_is_derived
from seft_plant_sim.rig_parameters import common_filter, filter_of

from seft_ros.bags.recording import Recording, every_step
from seft_ros.drawing.style import TextTable
from seft_ros.ground_motion.conditioning import moved_ahead
from seft_ros.identification import multisine_estimates as estimates
from seft_ros.identification.channel_filters import HIGHEST, ChannelFilters, channel_filters
from seft_ros.identification.identified import Identified
from seft_ros.identification.measured_test import frequency_response, motion_spectra
from seft_ros.identification.multisine import (
    OF_RATE,
    Multisine,
    Sine,
    fault_free_relations,
    no_images,
)
from seft_ros.identification.rig_tests import known_mass

_FEWEST_PERIODS, _SEGMENT = 3.0, 4.0  # of a spectrum: of the lowest frequency, and s
MIN_LAG = 2e-5
"""A lag below costs less than 0.4 % of the displacement, s (rig.md): channels that wait for it
would spread a wrong sample over the next ones."""


@dataclass(frozen=True)
class Calibrated:
    """What a multisine test adds to what was known of the channels.

    Attributes
    ----------
    found : dict
        Scale, lag and bias of the channels as published in the multisine test, shape (4, n), and
        the tilt of the accelerometers of each rig, (n, n): of what is within `SIGNIFICANT`
        standard errors, nothing is known. Filters if they are others than those that were known.
    whole : dict
        With what was known before: `parameters` of the rig.
    common_lag : float
        Part of the lag of a recording that `corrected` gives which is not in ``whole``, s: it
        counts as dead time of the actuator.
    derived : bool
        Whether the velocity is derived from the displacement.
    """

    found: dict[str, Floats]
    whole: dict[str, Floats]
    common_lag: float
    derived: bool

    @classmethod
    def of_multisine(
        cls, fit: estimates.MultisineFit, filters: ChannelFilters, experiment: Experiment
    ) -> "Calibrated":
        """Combine a multisine test with the calibration of its own experiment."""
        section = experiment["reference_force"]
        known, derived = all_known(experiment), section["sensors.velocity"] == "derived"
        lag = significant(fit.lag, np.maximum(fit.lag_error, MIN_LAG / SIGNIFICANT))
        scale = 1.0 + significant(fit.scale - 1.0, fit.scale_error)
        bias = significant(fit.bias, fit.bias_error)
        if derived:
            scale[VELOCITY], lag[VELOCITY], bias[VELOCITY] = 1.0, lag[0], 0.0
        off = significant(fit.tilt - np.eye(len(fit.tilt)), fit.tilt_error)
        one = scale[ACCELERATION]
        tilt = np.eye(len(off)) + np.where(of_one_rig(experiment.axes), off, 0.0)
        shown = bias.copy()
        shown[ACCELERATION] = known["tilt"] @ bias[ACCELERATION]
        passed = {"filter": filters.filter, "filter_damping": filters.filter_damping}
        whole = passed | {
            "scale": known["scale"] * scale,
            "bias": known["bias"] + known["scale"] * shown,
            "lag": known["lag"] + lag,
            "tilt": known["tilt"] * one / one[:, np.newaxis] @ tilt,
        }
        earliest = max(0.0, -float(whole["lag"].min()))
        whole["lag"] = whole["lag"] + earliest
        common = float(known["lag"].max() + lag.max()) + earliest
        found = {"scale": scale, "lag": lag, "bias": bias, "tilt": tilt}
        is_other = np.any([own != known[what] for what, own in passed.items()], axis=0)
        for what, own in passed.items():
            found[what] = np.where(is_other, own, NOTHING_KNOWN[what])
        calibrated = cls(found, whole, common, derived)
        return replace(calibrated, common_lag=common + calibrated.common_filter[0])

    @property
    def common_filter(self) -> tuple[float, float]:
        """Filter that all channels get, see `seft_plant_sim.rig_parameters.common_filter`."""
        return common_filter(_parameters(self.whole, False))

    @property
    def changes(self) -> bool:
        """Whether anything was found that was not known."""
        known = any((self.found[what] != nothing).any() for what, nothing in NOTHING_KNOWN.items())
        return known or _is_tilted(self.found["tilt"])

    def parameters(self) -> Section:
        """Values of ``calibration.*``, complete."""
        return _parameters(self.whole, self.derived)

    def corrected(self, recording: Recording) -> Recording:
        """Take what was found out of a recording of the same rig, from rest to rest.

        The channels wait for the latest one, as in the rig, but at each frequency for that time.
        """
        axes, dt = recording.experiment.axes, recording.experiment.timebase.dt
        lag = self.found["lag"]
        nothing = {what: np.full_like(lag, NOTHING_KNOWN[what]) for what in ("lag", *_FILTER)}
        section = _parameters(self.found | nothing, False)
        known, state = calibration.calibration_of(section, axes, range(len(axes)), dt)
        recording, values = as_measured(recording), _samples(recording).copy()
        if len(known.scale):
            calibration.calibrate_all(known, state, values)
        line = np.linspace(values[0], values[-1], len(values))
        flat, lead = (values - line).reshape(len(values), -1), (lag - lag.max()).ravel()
        passed = self._passed(recording.experiment)
        values = line + moved_ahead(flat, lead, dt, passed).reshape(line.shape)
        every = np.arange(len(values))
        measured = recording.series[RIG_STATE.name]
        values = np.concatenate([values, every_step(measured, every)[:, 4:]], axis=1)
        whole = replace(measured, steps=every, values=values, received_ns=None)
        return replace(recording, series={**recording.series, RIG_STATE.name: whole})

    def _passed(self, experiment: Experiment) -> Callable[[Floats], Complexes] | None:
        """Response from the channels as published to the one that all are to have, (m, 4n)."""
        if not any((self.found[what] != NOTHING_KNOWN[what]).any() for what in _FILTER):
            return None
        own = ChannelFilters.of(self.whole)
        p, q = self.common_filter

        def response(w: Floats) -> Complexes:
            s = 1j * w[:, np.newaxis, np.newaxis]
            common = 1.0 / (1.0 + p * s + q * s * s)
            passed = common / own.response(w) / as_told(experiment)(w)
            return np.asarray(passed.reshape(len(w), -1))

        return response


_FILTER = "filter", "filter_damping"


def as_told(experiment: Experiment) -> Callable[[Floats], Complexes]:
    """Response of what a test passes its channels through, beside waits, shape (..., 4, n)."""
    dt, n = experiment.timebase.dt, len(experiment.axes)
    known = calibration.aligned_to(experiment["reference_force"], experiment.axes, range(n))

    def response(w: Floats) -> Complexes:
        passed, z = np.ones((*w.shape, 4, n), complex), np.exp(-1j * w * dt)
        for row, i in zip(*np.nonzero(known.lacks), strict=True):
            taps = calibration.lacking(known.filters[:, row, i], known.common, dt)
            numerator, denominator = (np.polyval(part[::-1], z) for part in taps)
            passed[..., row, i] = numerator / denominator
        return passed

    return response


def as_measured(recording: Recording) -> Recording:
    """Put the samples as measured in place of the judged ones: the judge trusts the channels."""
    states, measured = recording.series[RIG_STATE.name], recording.measured.values
    values = np.concatenate([measured, states.values[:, measured.shape[1] :]], axis=1)
    series = {name: own for name, own in recording.series.items() if name != MEASURED.name}
    return replace(recording, series={**series, RIG_STATE.name: replace(states, values=values)})


def all_known(experiment: Experiment) -> dict[str, Floats]:
    """Give what an experiment tells of the channels, as `Calibrated.whole` is."""
    section, axes = experiment["reference_force"], experiment.axes
    tilt = tilt_of(section, axes, range(len(axes)), TILT)
    return calibration.known_channels(section, axes) | {"tilt": tilt}


def _is_tilted(tilt: Floats) -> bool:
    return bool((tilt != np.eye(len(tilt))).any())


def _parameters(known: Mapping[str, Floats], derived: bool) -> dict[str, Any]:
    parameters: dict[str, Any] = {
        f"calibration.{channel}_{what}": known[what][row].tolist()
        for row, channel in enumerate(CHANNELS)
        for what in NOTHING_KNOWN
        if not (derived and channel == "velocity")
    }
    parameters[TILT] = known["tilt"].ravel().tolist() if _is_tilted(known["tilt"]) else [0.0]
    return parameters


@dataclass(frozen=True)
class MultisineResult:
    """A multisine test, and what it has found.

    Attributes
    ----------
    multisine : Multisine
        Its plan.
    largest : dict
        Largest measured magnitude of any axis: ``displacement``, ``velocity``, ``acceleration``,
        ``force``; SI units.
    fit : MultisineFit
        Of the channels as published.
    filters : ChannelFilters
        Of the channels, see `found_filters`.
    calibrated : Calibrated
        The calibration that follows.
    known : ndarray
        Mass matrix that was known before, shape (n, n), kg.
    is_weighed : bool
        Whether the masses of the axes were weighed.
    force_scale_error : ndarray
        Standard error of the forces' scale, relative, shape (n,); 0: nobody told it.
    """

    multisine: Multisine
    largest: dict[str, float]
    fit: estimates.MultisineFit
    filters: ChannelFilters
    calibrated: Calibrated
    known: Floats
    is_weighed: bool
    force_scale_error: Floats

    @classmethod
    def of_recording(
        cls,
        multisine: Multisine,
        recording: Recording,
        sines: Sequence[Sine],
        found: Identified,
        known: Calibrated,
        filters: ChannelFilters | None = None,
        weighed: Sequence[float] = (),
        tilt_elsewhere: tuple[Floats, Floats] | None = None,
    ) -> "MultisineResult":
        """Evaluate the recording of a multisine test.

        ``found`` was identified from a recording that ``known`` has corrected; ``filters`` are
        those of the channels, by default as known. ``weighed`` are the masses of the axes, kg,
        ``tilt_elsewhere`` the tilt by `tilt_in`.

        Raises
        ------
        InputError
            If the mass does not stand out from its standard errors: friction holds the specimen.
        """
        experiment, samples = recording.experiment, _samples(recording)
        dt = experiment.timebase.dt
        filters = filters or ChannelFilters.of(all_known(experiment))
        of = estimates.harmonics(samples, sines, dt).passed(_unfiltered(filters, experiment))
        late = known.found["lag"] - known.found["lag"].min()
        times = [valve.actuator.dead_time for valve in found.valves] or [0.0]  # of servos
        dead_time = np.mean(times) - late.max() - known.common_filter[0]
        passed = filter_of(filters.filter, filters.filter_damping)
        seen = max(float(dead_time), 0.0), late, passed
        fault_free = fault_free_relations(found, sines, dt, *seen)
        derived = velocity_is_derived(experiment["reference_force"])
        fit = estimates.fit_multisine(of, fault_free, derived, tilt_elsewhere)
        fit = fit.behind_filters(filters.unsure(of.w))
        least, error = np.linalg.eigvalsh(fit.mass)[0], np.linalg.norm(fit.mass_error)
        if least <= SIGNIFICANT * error:
            sticks = f"the specimen sticks under sines of {1e3 * multisine.travel:.3g} mm"
            mend = "give a larger --travel, so that it slips"
            least_mass = f"its least mass is {least:.3g} ± {error:.2g} kg"
            raise InputError(f"multisine: {sticks}: {least_mass}; {mend}")
        told = experiment["reference_force"]["calibration.force_scale_error"]
        scale_error = per_axis(told, experiment.axes, "/**: calibration.force_scale_error")
        if weighed:
            fit = fit.weighed(np.array(weighed))
            scale_error = fit.scale_error[FORCE] / fit.scale[FORCE]
        peaks = dict(zip(CHANNELS, np.abs(samples).max(axis=(0, 2)).tolist(), strict=True))
        calibrated = Calibrated.of_multisine(fit, filters, experiment)
        mass = known_mass(experiment)
        return cls(multisine, peaks, fit, filters, calibrated, mass, bool(weighed), scale_error)

    def facts(self) -> Section:
        """Give the calibration, and the mass, with standard errors.

        Of a specimen that rubs or yields the damping, too: to a test by random commands, which
        has no one amplitude, that is damping, several times as much as at the amplitudes to come.
        """
        fit = self.fit
        damping = {"specimen.damping": _damping_of(fit).ravel().tolist()} if fit.rubs else {}
        mass = {
            "specimen.mass": significant(fit.mass, fit.mass_error).ravel().tolist(),
            "specimen.mass_error": fit.mass_error.diagonal().tolist(),
            "calibration.force_lag_error": fit.lag_error[FORCE].tolist(),
            "calibration.force_scale_error": self.force_scale_error.tolist(),
        }
        return damping | self.calibrated.parameters() | mass

    def numbers(self, axes: Sequence[str]) -> dict[str, Any]:
        """Give ``multisine`` of ``seft identify --json``: SI units, errors are standard errors."""
        every, by_axis = vars(self.fit) | vars(self.filters), list[dict[str, Any]]()

        def of(what: str, *at: int) -> dict[str, float]:
            return {"value": float(every[what][at]), "error": float(every[f"{what}_error"][at])}

        for i, axis in enumerate(axes):
            by_axis.append({"axis": axis, "mass": of("mass", i, i), "damping": of("damping", i, i)})
            for row, channel in enumerate(CHANNELS):
                by_axis[i][channel] = {what: of(what, row, i) for what in NOTHING_KNOWN}
        matrices = ("mass", "mass_error", "tilt", "tilt_error")
        return {
            "travel": self.multisine.travel,
            "frequencies_hz": self.multisine.frequencies.tolist(),
            "largest": self.largest,
            **{name: every[name].squeeze().tolist() for name in matrices},
            "axes": by_axis,
        }


def _damping_of(fit: estimates.MultisineFit) -> Floats:
    """Damping matrix that feeds no energy, shape (n, n), N s/m."""
    values, vectors = np.linalg.eigh(fit.damping)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _unfiltered(filters: ChannelFilters, experiment: Experiment) -> Callable[[Floats], Complexes]:
    """Response from the channels as published to what they would show without filters."""
    told = as_told(experiment)
    return lambda w: 1.0 / (told(w) * filters.response(w))


def _lines(
    recording: Recording, band: tuple[float, float]
) -> tuple[estimates.Harmonics, tuple[float, float]]:
    """Cross spectra with the commands of a random test, up to `HIGHEST` times the rate.

    They take the place of the sines of a multisine test. Also the band that they cover, Hz.
    """
    n, dt = len(recording.experiment.axes), recording.experiment.timebase.dt
    samples, command = _samples(recording), recording.series[VALVE_COMMAND.name]
    every = np.arange(len(samples))
    driven = every_step(command, every)[:, 0]
    signals = np.concatenate([driven, samples.reshape(len(samples), -1)], axis=1)
    # averages of more segments than inputs, or nothing of the noise would be seen
    segment = min(max(_FEWEST_PERIODS / band[0], _SEGMENT), len(samples) * dt / (n + 2))
    spectra = motion_spectra(signals, 1.0 / dt, segment)
    used = max(band[0], _FEWEST_PERIODS / segment), min(band[1], HIGHEST / dt)
    response = frequency_response(spectra, slice(0, n), slice(n, 5 * n), used)
    shape = (len(response.frequencies_hz), 4, n, n)
    amplitude = np.moveaxis(response.response.reshape(shape), 3, 0).reshape(-1, 4, n)
    deviation = np.sqrt(np.maximum(response.variance(), 0.0) / 2.0).reshape(shape)
    noise = np.moveaxis(deviation, 3, 0).reshape(-1, 4, n)
    w, nothing = np.tile(2 * np.pi * response.frequencies_hz, n), np.zeros_like(noise)
    lines, errors = amplitude[:, np.newaxis], noise[:, np.newaxis]
    of = estimates.Harmonics(w, lines, errors, nothing, nothing[:, 0, 0], nothing[0])
    return of, used


def found_filters(
    recording: Recording, band: tuple[float, float], multisine: MultisineResult | None = None
) -> ChannelFilters:
    """Find the filters of the channels in a test by random commands.

    A multisine test before tells the mass.
    """
    experiment, (of, used) = recording.experiment, _lines(recording, band)
    section, known = experiment["reference_force"], ChannelFilters.of(all_known(experiment))
    if section["sensors.acceleration"] == "derived":
        return known
    mass = known_mass(experiment)
    error = np.full_like(mass, mass.max())
    if multisine is not None:
        fit, scale = multisine.fit, multisine.calibrated.found["scale"][ACCELERATION]
        shown = scale[:, np.newaxis] * multisine.calibrated.found["tilt"]
        mass, error = fit.mass @ np.linalg.inv(shown), fit.mass_error
    told = as_told(experiment)(of.w)
    derived = section["sensors.velocity"] == "derived"
    amplitude, noise = of.amplitude / told, of.noise / np.abs(told)
    found = channel_filters(of.w, amplitude, noise, experiment.timebase.dt, (mass, error), derived)
    return found.apart_from(known, used[1])


def rough_calibration(
    recording: Recording, band: tuple[float, float], filters: ChannelFilters
) -> Calibrated:
    """Estimate the channels from a test by random commands, well enough for the actuators' fit.

    Up to `OF_RATE` times the rate and within the band of the excitation, Hz. The force's lag is
    that of ``filters``: at these frequencies friction spoils it.
    """
    of, fault_free, derived = _low_lines(recording, band, filters)
    fit = estimates.fit_multisine(of, fault_free, derived)
    fit.lag[FORCE], fit.lag_error[FORCE] = fit.lag[ACCELERATION] + filters.force_lag, 0.0
    return Calibrated.of_multisine(fit, filters, recording.experiment)


def tilt_in(
    recording: Recording, band: tuple[float, float], filters: ChannelFilters
) -> tuple[Floats, Floats]:
    """Give the tilt in a test by random commands, and its standard errors, shape (n, n) each."""
    of, (fault_free, _), derived = _low_lines(recording, band, filters)
    return estimates.tilt_shown(of, fault_free, derived)


def _low_lines(
    recording: Recording, band: tuple[float, float], filters: ChannelFilters
) -> tuple[estimates.Harmonics, tuple[Complexes, Floats], bool]:
    """Lines without filters, what a rig without faults shows of them, whether v is derived."""
    experiment, (of, _) = recording.experiment, _lines(recording, band)
    low = of.w <= 2 * np.pi * OF_RATE / experiment.timebase.dt
    lines = of.w[low], of.overtones[low], of.errors[low], of.mean[low], of.time[low], of.rounding
    of = estimates.Harmonics(*lines).passed(_unfiltered(filters, experiment))
    derived = velocity_is_derived(experiment["reference_force"])
    return of, no_images(len(of.w)), derived


def moved_by(recording: Recording, sines: Sequence[Sine]) -> Floats:
    """Amplitude of the displacement of each sine in a multisine test's recording, shape (m,), m."""
    of = estimates.harmonics(_samples(recording), sines, recording.experiment.timebase.dt)
    return np.array([abs(of.amplitude[k, 0, sine.axis]) for k, sine in enumerate(sines)])


def _samples(recording: Recording) -> Floats:
    """Give the samples at every step as measured, shape (N, 4, n)."""
    states = as_measured(recording).states
    return every_step(states, np.arange(states.steps[-1] + 1))


SAME_MASS = 0.02
"""Of the mass, which costs 1 to 2 % of the displacement: what it may differ by."""
_UNITS = {  # channel: unit and factor of its bias
    "velocity": ("mm/s", 1e3),
    "acceleration": ("m/s²", 1.0),
    "force": ("N", 1.0),
    "displacement": ("mm", 1e3),
}


def multisine_table(result: MultisineResult, axes: Sequence[str]) -> TextTable:
    """Tabulate what a multisine test has found, with standard errors, a column for each axis."""
    found = result.numbers(axes)["axes"]

    def cell(number: Mapping[str, float], unit: str, scale: float) -> str:
        error = scale * number["error"]
        digits = int(max(0, min(6, 1 - math.floor(math.log10(error))))) if error > 0 else 3
        return f"{scale * number['value']:.{digits}f} ± {error:.{digits}f} {unit}".rstrip()

    rows: list[list[str] | None] = [["mass", *(cell(one["mass"], "kg", 1.0) for one in found)]]
    if result.fit.rubs:
        rows.append(["damping", *(cell(one["damping"], "N s/m", 1.0) for one in found)])
    for channel, of_bias in _UNITS.items():
        if channel == "velocity" and result.calibrated.derived:
            continue
        label = f"{channel}: "
        of_channel = {"scale": ("", 1.0), "lag": ("ms", 1e3), "filter": ("Hz", 1.0)}
        for what, form in (of_channel | {"filter_damping": ("", 1.0), "bias": of_bias}).items():
            if any(one[channel][what]["error"] for one in found):  # it is not the reference
                cells = (cell(one[channel][what], *form) for one in found)
                rows.append([label + what.replace("_", " "), *cells])
                label = "  "
    return TextTable(["multisine", *axes], rows)


_NOT_CORRECTED = "; the axes have their own rigs, and neither can correct it: mount it straight"


def multisine_notes(result: MultisineResult, axes: Sequence[str]) -> list[str]:
    """List what a reader must know about a multisine test, one line each."""
    fit, reference = result.fit, "the weighed mass" if result.is_weighed else "load cell"
    other = "displacement's if velocity and acceleration agree against it"
    against = f"masses and scales are against them ({other}), lags against the earliest channel"
    found = [f"multisine: {reference} and displacement sensor are the reference: {against}"]
    if fit.rubs:
        rubs = "the specimen rubs or yields, which the open loop takes for damping"
        found.append(f"multisine: {rubs}: specimen.damping is the multisine's")
    masses = (each.diagonal() for each in (result.known, fit.mass, fit.mass_error))
    for axis, known, mass, error in zip(axes, *masses, strict=True):
        off = abs(mass - known) > max(SIGNIFICANT * error, SAME_MASS * mass)
        if off and not result.is_weighed:
            share = f"{mass / known * 100:.1f} %"
            shows = f"the load cell shows {share} of the force; then give --known-mass"
            differs = f"axis {axis}: mass {mass:.4g} kg, configured {known:.4g} kg"
            found.append(f"{differs}: if that was weighed, {shows}")
    off = np.abs(fit.tilt - np.eye(len(axes))) > SIGNIFICANT * fit.tilt_error
    for i, j in zip(*np.nonzero(off & ~np.eye(len(axes), dtype=bool)), strict=True):
        is_known = result.calibrated.found["tilt"][i, j]
        mend = f"; {TILT} corrects it" if is_known else _NOT_CORRECTED
        shown = f"the accelerometer shows {fit.tilt[i, j]:.2g} of the acceleration of {axes[j]}"
        found.append(f"axis {axes[i]}: {shown}: it is tilted{mend}")
    return found
