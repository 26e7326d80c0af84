"""Fit of one joint's parameters to windows of its motion, with uncertainties that the residuals bear out.

Least squares with Gaussian priors: what the data do not determine stays at its prior and says so.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.optimize import least_squares

from twind.identification.servo_parameters import ServoPriors
from twind.robot.arrays import Bools, Floats

# Maps candidates (c, p), in units of the parameters, to errors (c, samples, windows), rad; NaN: no sample.
ErrorFunction = Callable[[Floats], Floats]
STARTS = 256  # candidates drawn from the prior, of which the best begin a fit
POLISHED = 3
ROUNDS = 2  # of the noise from the residuals
DIFFERENCE = 1e-3  # of a number of the fit, for the Jacobian
MODEL_ERROR = 1.6  # factor on the noise: effects that the model lacks repeat in all windows
ORDER = 2  # samples from which the next error is foretold
FLOOR = 3e-4  # rad, of the noise: rounding of encoders
MOVED = 1.0  # deviations of the prior: data that move an estimate so far say something of it
DETERMINED = 0.75  # share of the prior's deviation that an estimate keeps at most


@dataclass(frozen=True, slots=True)
class JointFit:
    """Result of a fit; arrays (p,) in the order of `FITTED`."""

    values: Floats
    sd: Floats
    determined: Bools
    covariance: Floats  # (p, p) of the numbers of the fit
    noise: Floats  # rad, of one independent sample


def fit_joint(
    errors: ErrorFunction,
    priors: ServoPriors,
    memory: int = ORDER,
    start: Floats | None = None,
    held: Bools | None = None,
    disturbed: ErrorFunction | None = None,
) -> JointFit:
    """Return the parameters that explain the motion best.

    `start` (p,): those of an earlier fit, from which this one begins. `held` (p,): parameters that stay at
    their prior; that they are uncertain widens the others. `disturbed`: the errors where an effect that the
    model lacks is as large as may be expected; what it would change in a parameter, widens its uncertainty.

    `memory`: samples from which the next error is foretold; only the rest of it counts. Slow errors, of what
    the model lacks, then hide less of what is quick. 0: errors count as they are, for slow motion predicted
    as a whole.
    """
    free = np.ones(len(priors.mean), np.bool_) if held is None else ~held
    drawn = np.where(free, _drawn(priors) if start is None else priors.encode(start[None]), 0.0)
    found = _best_of(errors, priors, drawn)
    noise = np.full(1, np.sqrt(np.mean(_finite(errors(priors.decode(found[:1]))) ** 2)))
    best = _polish(errors, priors, found, noise, free)
    plain = errors
    starts = drawn
    for _ in range(ROUNDS):
        shares = _memory(plain(priors.decode(best[None]))[0], memory)
        errors = _whitened(plain, shares)
        noise = _noise(errors(priors.decode(best[None]))[0])
        # Another start may be the better one for this measure of errors.
        others = _best_of(errors, priors, starts)
        best = _polish(errors, priors, np.unique(np.stack([best, *others]), axis=0), noise, free)
        starts = best[None]
    error, jacobian = _linearized(errors, priors, best)
    # With what is held, the data may determine what they leave open without.
    known = np.sqrt(np.diag(_covariance(jacobian * free[:, None, None], error, noise)))
    determined = ((known < DETERMINED) | (np.abs(best) > MOVED)) & free
    covariance = _covariance(jacobian, error, noise)
    if disturbed is not None:
        changed = _whitened(disturbed, shares)(priors.decode(best[None]))[0] - error
        moved = _moved(jacobian, changed, noise)
        covariance = covariance + np.outer(moved, moved)
    spread = np.sqrt(np.diag(covariance))
    best = _polish(errors, priors, np.where(determined, best, 0.0)[None], noise, determined)
    values = priors.decode(np.where(determined, best, 0.0))
    positive = priors.logarithmic > 0.0
    sd = np.where(positive, spread * priors.sd / priors.mean * values, spread * priors.sd)
    return JointFit(values, np.where(determined, sd, priors.sd), determined, covariance, noise)


def _drawn(priors: ServoPriors) -> Floats:
    """Return the prior's mean and many candidates drawn from it, as numbers of the fit (k, p)."""
    drawn = np.random.default_rng(0).normal(0.0, 1.0, (STARTS, len(priors.mean)))
    drawn[0] = 0.0
    return np.maximum(drawn, priors.lowest)


def _best_of(errors: ErrorFunction, priors: ServoPriors, drawn: Floats) -> Floats:
    """Return the `POLISHED` candidates that explain the motion best."""
    cost = np.nanmean(errors(priors.decode(drawn)) ** 2, axis=(1, 2))
    return drawn[np.argsort(cost)[:POLISHED]]


def _polish(errors: ErrorFunction, priors: ServoPriors, starts: Floats, noise: Floats, free: Bools) -> Floats:
    """Return the best minimum (p,) that is reached from `starts` (k, p); only those `free` (p,) change."""
    moving = free.astype(np.float64)

    @lru_cache(maxsize=1)  # the slopes are nearly always asked for where the errors were asked for last
    def linearized(packed: bytes) -> tuple[Floats, Floats]:
        return _linearized(errors, priors, np.frombuffer(packed))

    def residuals(numbers: Floats) -> Floats:
        error, _ = linearized(numbers.tobytes())
        return np.append(_finite(error) / noise, numbers)

    def slopes(numbers: Floats) -> Floats:
        _, table = linearized(numbers.tobytes())
        table = table * moving[:, None, None]
        return np.concatenate([_rows(table) / noise, np.eye(len(numbers))])

    found = [
        least_squares(
            residuals,
            start,
            jac=slopes,
            bounds=(priors.lowest - 1e-9, np.inf),
            loss="linear",
            max_nfev=25,
            xtol=1e-4,
            ftol=1e-4,
        )
        for start in starts
    ]
    return np.asarray(min(found, key=lambda each: float(each.cost)).x)


def _linearized(errors: ErrorFunction, priors: ServoPriors, numbers: Floats) -> tuple[Floats, Floats]:
    """Return the errors (samples, windows), and their slopes (p, samples, windows) by the numbers of the fit.

    One call for both: a simulation of many candidates takes little longer than that of one.
    """
    count = len(numbers)
    steps = DIFFERENCE * np.concatenate([np.eye(count), -np.eye(count)])
    around = np.maximum(numbers + steps, priors.lowest)
    table = errors(priors.decode(np.concatenate([around, numbers[None]])))
    width = np.diag(around[:count] - around[count:])
    return table[-1], (table[:count] - table[count:-1]) / width[:, None, None]


def _memory(error: Floats, count: int) -> Floats:
    """Return by how much errors (samples, windows) follow from the last `count` (count,): Yule-Walker."""
    if count == 0:
        return np.zeros(0)
    known = np.nan_to_num(error)
    power = np.fft.rfft(known, 2 * len(known), axis=0)
    shared = np.fft.irfft(np.abs(power) ** 2, axis=0).sum(axis=1)[: count + 1]
    shared[0] += known.size * FLOOR**2
    return np.asarray(solve_toeplitz(shared[:-1], shared[1:]))


def _whitened(errors: ErrorFunction, memory: Floats) -> ErrorFunction:
    """Return the part of errors that does not follow from those before it; the first samples are dropped."""

    def innovations(values: Floats) -> Floats:
        table = errors(values)
        fresh = table[:, len(memory) :].copy()
        for lag, share in enumerate(memory.tolist(), start=1):
            fresh -= share * table[:, len(memory) - lag : table.shape[1] - lag]
        return fresh

    return innovations


def _noise(error: Floats) -> Floats:
    """Return the deviation (1,) of one independent sample, from errors (samples, windows).

    Residuals follow one another: so many samples tell as much as one, and the noise grows by its root.
    """
    known = np.nan_to_num(error)
    power = np.fft.rfft(known, 2 * len(known), axis=0)
    shared = np.fft.irfft(np.abs(power) ** 2, axis=0).sum(axis=1)[: len(known)]
    positive = np.argmax(shared <= 0.05 * shared[0]) or len(known)
    length = 1.0 + 2.0 * shared[1:positive].sum() / max(shared[0], 1e-30)
    return np.array([MODEL_ERROR * np.sqrt(length * (np.nanmean(error**2) + FLOOR**2))])


def _covariance(jacobian: Floats, error: Floats, noise: Floats) -> Floats:
    """Return the covariance (p, p) of the numbers of the fit: the larger of two estimates by parameter.

    The first takes residuals as noise of their own length; the second takes windows as independent and lets
    their gradients speak, which errors of the model in some of the motions widen.
    """
    rows = _rows(jacobian) / noise
    count = rows.shape[1]
    curvature = rows.T @ rows + np.eye(count)
    plain = np.linalg.inv(curvature)
    gradients = np.einsum("psw,sw->wp", np.nan_to_num(jacobian), np.nan_to_num(error)) / noise**2
    spread = gradients.T @ gradients + np.eye(count)
    clustered = plain @ spread @ plain
    widened = np.maximum(np.diag(clustered) / np.diag(plain), 1.0)
    scale = np.sqrt(widened)
    return np.asarray(plain * scale[:, None] * scale, np.float64)


def _moved(jacobian: Floats, changed: Floats, noise: Floats) -> Floats:
    """Return by how much errors that are `changed` (samples, windows) move the numbers of the fit (p,)."""
    rows = np.nan_to_num(jacobian / noise).reshape(len(jacobian), -1)
    target = np.nan_to_num(changed / noise).ravel()
    return np.asarray(np.linalg.solve(rows @ rows.T + np.eye(len(rows)), rows @ target), np.float64)


def _finite(errors: Floats) -> Floats:
    return errors[np.isfinite(errors)]


def _rows(jacobian: Floats) -> Floats:
    flat = jacobian.reshape(len(jacobian), -1)
    return flat[:, np.isfinite(flat).all(axis=0)].T
