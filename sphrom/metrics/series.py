"""Time series: averages, growth rates and frequencies."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from itertools import product

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sphrom.arrays import Array

ZERO_PADDING = 8
"""Refinement of the spectrum beyond the resolution of the record."""
FEWEST_PERIODS = 2.0
"""Fewest periods in a record: slower changes look like a trend."""
FEWEST_SAMPLES = 8
"""Fewest samples in a record with a spectrum."""
OSCILLATION = ("frequency", "amplitude", "mean", "frequency_scatter", "amplitude_scatter")
"""Figures of an oscillation [Hz for frequencies, else the unit of the signal]."""
PHASE = "phase"
"""The phase at the end of a record, beside that of another one [deg]."""
ESTIMATED = (*OSCILLATION[:3], PHASE)
"""Figures of an oscillation with estimated errors."""
PER_PERIOD = 64
"""Samples per period of a demodulated oscillation."""
MOST_CORRECTIONS, CONVERGED = 30, 1e-13
"""Largest number of corrections of a frequency, and relative size of the last one."""
STEADY, SHEDDING, UNDECIDED = REGIMES = ("steady", "shedding", "undecided")
"""Regimes of a flow: below the onset of its oscillation, beyond it, or too close to tell."""
BELOW_ONSET = "the model's flow is steady there, below the onset of the oscillation"
"""Why a run in the regime STEADY has no frequency and no amplitude."""
TOO_CLOSE = "it lies within the range of onset estimates: the flow may oscillate or be steady"
"""A warning about a run in the regime UNDECIDED."""
NO_OSCILLATION = "fewer than three periods of an oscillation"
"""Why a record has no frequency and no amplitude."""
AT_REST, SETTLED, LEAST_SETTLED = 0.05, 1e-3, 0.1
"""For a driving that grows from zero: largest first value, and largest deviation when settled, both
relative to the final value, and smallest share of the time in which it is settled."""
UNIFORM_TOLERANCE = 1e-3
"""Largest relative difference between the intervals of a record."""


def hat(n_half: int) -> Array:
    """Return weights (2 n_half - 1,) that rise and fall linearly, with sum one.

    Averages with them cancel oscillations whose period is n_half intervals or a whole part of it.
    """
    box = np.full(n_half, 1.0 / n_half)
    return np.convolve(box, box)


def moving_average(values: Array, weights: Array) -> Array:
    """Return averages (n - n_weights + 1, ...) along the first axis of values (n, ...).

    Raises ValueError if there are fewer values than weights.
    """
    return np.asarray(sliding_window_view(values, len(weights), axis=0) @ weights)


def smoothed(values: Array, weights: Array) -> Array:
    """Return averages (n, ...) around all values (n, ...); near the ends, of the existing values.

    The number of weights is odd.
    """
    beside = [(len(weights) // 2,) * 2, *[(0, 0)] * (values.ndim - 1)]
    shares = moving_average(np.pad(np.ones(len(values)), beside[0]), weights)
    sums = moving_average(np.pad(values, beside), weights)
    return sums / shares.reshape(-1, *(1,) * (values.ndim - 1))


def at_instants(time: Array, values: Array, instants: Array) -> Array:
    """Return values (n_snapshots, ...) at instants (n_instants,) [s], by cubic splines."""
    if len(time) == len(instants) and np.allclose(time, instants, rtol=0.0, atol=1e-12):
        return values
    from scipy.interpolate import make_interp_spline  # importing it takes long

    spline = make_interp_spline(time, values, k=min(3, len(time) - 1))
    return np.asarray(spline(np.clip(instants, time[0], time[-1])))


def kinetic_energy(velocity: Array, mass: Array | float) -> Array:
    """Return sum m |u|^2 / 2 [J per metre of depth] of velocities (..., n_particles, n_dim)."""
    return 0.5 * np.sum(mass * np.sum(velocity**2, axis=-1), axis=-1)


def exponential_rate(time: Array, value: Array) -> float:
    """Return the slope of log(value) over time [1/s], by least squares: negative for a decay.

    Raises ValueError for fewer than two different times or values that are not positive.
    """
    value = np.asarray(value, dtype=float)
    if not np.all(np.isfinite(value) & (value > 0.0)):
        raise ValueError("a rate needs values that are positive and finite")
    return _slope(np.asarray(time, dtype=float), np.log(value))


def dominant_frequency(time: Array, signal: Array) -> float:
    """Return the frequency [Hz] of the strongest oscillation of a signal (n_samples,).

    A plain spectrum of a record of n periods has a resolution of 1/n. Therefore the trend is taken
    out, a Hann window applied, and a parabola put through the logarithms of the peak's amplitudes.

    Raises ValueError for times that are not evenly spaced, values that are not finite, and a record
    shorter than two periods of its strongest oscillation.
    """
    interval = _interval(time, signal)
    window = np.hanning(len(signal) + 2)[1:-1]
    n_padded = ZERO_PADDING * len(signal)
    trend = _slope(time, signal) * (time - time.mean())
    amplitude = np.abs(np.fft.rfft((signal - signal.mean() - trend) * window, n_padded))
    frequency = np.fft.rfftfreq(n_padded, interval)
    slowest = FEWEST_PERIODS / (interval * len(signal))
    first = max(1, int(np.searchsorted(frequency, slowest)))
    peak = first + int(np.argmax(amplitude[first:-1]))
    rounding = float(np.finfo(np.float64).eps) * len(signal) * float(np.abs(signal).max())
    if not amplitude[peak] > max(rounding, amplitude[peak - 1], amplitude[peak + 1]):
        raise ValueError(f"no oscillation of {FEWEST_PERIODS:g} periods or more is in the record")
    below, at, above = np.log(amplitude[peak - 1 : peak + 2])
    offset = 0.5 * (below - above) / (below - 2.0 * at + above)
    return float((peak + offset) / (n_padded * interval))


def oscillation(time: Array, signal: Array) -> dict[str, float]:
    """Return the strongest oscillation of a signal (n_samples,), by OSCILLATION.

    The frequency is the one at which the phase of the demodulated signal has no trend. The
    amplitude is half the peak to peak of the fundamental, and the mean is over whole periods.
    Scatters are standard deviations over the record, with frequencies of single periods. A signal
    without three periods has only a mean, and one without samples has no figures.
    """
    with suppress(ValueError):
        most, frequency = 0.5 / _interval(time, signal), 0.0
        with suppress(ValueError):
            frequency = dominant_frequency(time, signal)
        if not frequency:  # a mean with larger changes may hide it
            frequency = dominant_frequency(time, np.gradient(signal))
        for _ in range(MOST_CORRECTIONS):
            instants, wave, mean = demodulated(time, signal, frequency)
            turns = np.unwrap(np.angle(wave)) / (2.0 * np.pi)
            size = np.abs(wave)
            change = _slope(instants, turns)
            frequency = min(frequency + change, most)
            if abs(change) <= CONVERGED * frequency:
                break
        rates = frequency * (turns[PER_PERIOD:] - turns[:-PER_PERIOD])
        if len(rates):
            found = frequency, size.mean(), mean.mean(), rates.std(), size.std()
            return dict(zip(OSCILLATION, map(float, found), strict=True))
    return {"mean": float(signal.mean())} if len(signal) else {}


def settled_from(time: Array, driving: Array) -> float:
    """Return the time at which a driving (n_components, n_times) reaches its final value [s].

    It is zero unless the driving grows from zero and then keeps its value for long enough.
    """
    first, final = driving[:, 0], driving[:, -1]
    size = float(np.linalg.norm(final))
    near = np.linalg.norm(driving - final[:, None], axis=0) <= SETTLED * size
    last = int(np.flatnonzero(~near).max(initial=0))
    grows = float(np.linalg.norm(first)) <= AT_REST * size
    settles = last < (1.0 - LEAST_SETTLED) * len(time)
    return float(time[last + 1]) if size > 0.0 and grows and settles else 0.0


def demodulated(
    time: Array, signal: Array, frequency: float
) -> tuple[Array, NDArray[np.complex128], Array]:
    """Return instants (n_instants,) [s], complex amplitudes of a signal there, and its means.

    The amplitude of a cos(2 pi f (t - t_0) + b) is a exp(i b), where t_0 is the first time.
    Averages by a hat over two periods cancel means, trends and harmonics; instants are at least a
    period from the ends. Raises ValueError for a record of less than two periods.
    """
    from scipy.interpolate import make_interp_spline

    if (n_periods := (time[-1] - time[0]) * frequency) < FEWEST_PERIODS:
        raise ValueError(f"a record must hold {FEWEST_PERIODS:g} periods")
    turns = np.arange(1 + int(n_periods * PER_PERIOD)) / PER_PERIOD
    instants = time[0] + turns / frequency
    values = make_interp_spline(time, signal, k=5)(instants)
    carriers = 2.0 * np.cos(2.0 * np.pi * turns), 2.0 * np.sin(2.0 * np.pi * turns), 1.0
    along, across, mean = (
        np.convolve(values * carrier, hat(PER_PERIOD), "valid") for carrier in carriers
    )
    return instants[PER_PERIOD - 1 : 1 - PER_PERIOD], along - 1j * across, mean


def oscillation_beside(time: Array, signal: Array, reference: Array) -> dict[str, float]:
    """Return the oscillation of a signal with its errors, if they exist.

    `frequency_error` and `amplitude_error` are relative [%], and `mean_error` has the signal's
    unit. `phase_error` is the phase by which the signal leads the reference at the end of the
    record [deg]; it accumulates over whole turns.
    """
    figures = oscillation(time, signal)
    expected = oscillation(time, reference)
    for figure in OSCILLATION[:2]:
        if figure in figures and expected.get(figure):
            figures[f"{figure}_error"] = 100.0 * abs(figures[figure] / expected[figure] - 1.0)
    if "mean" in figures:
        figures["mean_error"] = abs(figures["mean"] - expected["mean"])
    if "frequency_error" in figures:
        waves = [demodulated(time, x, expected["frequency"])[1] for x in (signal, reference)]
        angles = np.unwrap(np.angle(waves[0] * waves[1].conj()))
        figures["phase_error"] = float(np.rad2deg(angles[-1]))
    return figures


def _interval(time: Array, signal: Array) -> float:
    """Return the interval between the samples of a record [s]."""
    if time.shape != signal.shape or len(time) < FEWEST_SAMPLES:
        raise ValueError(f"a spectrum needs {FEWEST_SAMPLES} samples or more, and as many times")
    intervals = np.diff(time)
    mean = float(intervals.mean())
    even = mean > 0.0 and np.allclose(intervals, mean, rtol=UNIFORM_TOLERANCE, atol=0.0)
    if not (even and np.all(np.isfinite(signal))):
        raise ValueError("a spectrum needs finite samples at equal intervals")
    return mean


def _slope(abscissa: Array, ordinate: Array) -> float:
    if abscissa.shape != ordinate.shape or np.unique(abscissa).size < 2:
        raise ValueError("a slope needs two different points or more, and as many values")
    centred = abscissa - abscissa.mean()
    return float(centred @ (ordinate - ordinate.mean()) / (centred @ centred))


N_RECORDS, N_IN_RECORD, N_SCALES = 64, 256, 36
"""Records of a signal at each scale, their samples, and the scales, each half of the one before."""
FEWEST_TURNS, MOST_TURNS = 8, 64
"""Turning points that show an oscillation: at least four periods, with eight samples in each."""
LEAST_CHANGE = 0.01
"""Smallest change between samples that counts, relative to the largest absolute value of the
signal."""
STENCIL, N_HALVINGS = (-1.0, -0.5, 0.0, 0.5, 1.0), 40
"""Places that the search for a peak compares, and the number of halvings of their distance."""
POLE = 1e4
"""Growth of a peak during that search, from which it must be a pole."""
N_PEAKS = 256
"""Largest number of peaks that are searched."""


def shortest_period(signal: Callable[[Array], Array], end: float) -> float:
    """Return the shortest period [s] of a signal between zero and a time [s]; infinite without one.

    Samples at one distance can't tell an oscillation from a slower one. Therefore short records
    are compared at many distances between samples, down to 1e-13 of the whole time: an oscillation
    turns many times in records of a few of its periods. A jump, a ramp or a pulse turns at most
    once or twice. Periods above a quarter of the whole time are not found.

    Parameters
    ----------
    signal : returns values (n_times,) or (n_components, n_times) at times [s].
    """
    apart = end / (N_IN_RECORD - 1) * 0.5 ** np.arange(N_SCALES)
    # Random, because starts at equal distances could see bursts that repeat as nothing.
    shares = (np.arange(N_RECORDS) + np.random.default_rng(0).random(N_RECORDS)) / N_RECORDS
    shares[0] = 0.0  # where bursts are likely
    starts = shares * (end - (N_IN_RECORD - 1) * apart[:, None])
    times = starts[..., None] + apart[:, None, None] * np.arange(N_IN_RECORD)
    values = np.atleast_2d(np.nan_to_num(signal(times.ravel()), posinf=0.0, neginf=0.0))
    shortest = math.inf
    for component in values:
        changes = np.diff(component.reshape(-1, N_IN_RECORD))
        row, column = np.nonzero(np.abs(changes) > LEAST_CHANGE * np.abs(component).max())
        rising = changes[row, column] > 0.0
        turns = np.flatnonzero((row[1:] == row[:-1]) & (rising[1:] != rising[:-1])) + 1
        record, first, number = np.unique(row[turns], return_index=True, return_counts=True)
        last = column[turns[first + number - 1]] - column[turns[first]]
        found = (number >= FEWEST_TURNS) & (number <= MOST_TURNS)
        periods = 2.0 * apart[record // N_RECORDS] * last / np.maximum(number - 1, 1)
        shortest = min(shortest, float(periods[found].min(initial=math.inf)))
    return shortest


def sharpened(
    function: Callable[[Array], Array], place: Array, width: Array, ends: Array
) -> tuple[Array, Array]:
    """Return the highest values (n_peaks,) of peaks beside places, and where these values are.

    Parameters
    ----------
    function : returns values (n_places,) at places (n_dim, n_places).
    place : (n_dim, n_peaks) samples with larger values than their neighbours.
    width : (n_dim,) distances of these neighbours.
    ends : (2, n_dim) the first and the last places.
    """
    stencil = np.array(list(product(STENCIL, repeat=len(place)))).T
    for halving in range(N_HALVINGS):
        reach = (0.5**halving * width)[:, None] * stencil
        around = np.clip(place[:, :, None] + reach[:, None], *ends[..., None, None])
        values = function(around.reshape(len(place), -1)).reshape(around.shape[1:])
        values = np.where(np.isnan(values), np.inf, values)
        best = values.argmax(axis=1)
        place = around[:, np.arange(best.size), best]
    return values.max(axis=1), place


def pole_of(signal: Callable[[Array], Array], times: Array) -> float | None:
    """Return a time [s] at which a signal isn't finite, between zero and the last; None if none.

    Parameters
    ----------
    signal : returns values (..., n_times) at times [s]; their absolute values are added.
    times : (n_times,) equal intervals of time [s] from zero.
    """

    def size(place: Array) -> Array:
        return np.abs(signal(place[0])).reshape(-1, place.size).sum(axis=0)

    with np.errstate(all="ignore"):
        values = size(times[None])
    if not np.isfinite(values).all():
        return float(times[np.argmin(np.isfinite(values))])
    beside = np.pad(values, 1, constant_values=-np.inf)
    peaks = np.flatnonzero((values >= beside[:-2]) & (values >= beside[2:]) & (values > 0.0))
    if not peaks.size:
        return None
    peaks = peaks[np.argsort(-values[peaks], kind="stable")[:N_PEAKS]]
    with np.errstate(all="ignore"):
        found, where = sharpened(size, times[None, peaks], times[1:2], times[[0, -1], None])
    poles = ~(found <= POLE * values[peaks])
    return float(where[0, poles][0]) if poles.any() else None
