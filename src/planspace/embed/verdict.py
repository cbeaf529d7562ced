"""A measurement in words: what is good, what is weak, what the demonstrations do not support, what to try."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass

from planspace.embed.about import SPLITS
from planspace.embed.demo_quality import DemoQuality
from planspace.embed.geometry import Geometry

NEARLY_STRAIGHT, STRAIGHTER = 0.8, 0.1
"""Straightness of nearly straight plans, and by how much z should be straighter than the raw state."""
FOLLOWS_TIME, KEEPS_STATE, LOSES_STATE = 0.9, 0.5, 0.8
SMALL_CHANGE = 1e-3
"""A change of z by a symmetry below this, in standard deviations, is rounding."""
MANY_OUTSIDE = 0.1
OVERFIT = 0.15
"""Plans of the training may be straighter than others by this much."""
FEW_MEASURED, FEW_DEMOS = 5, 15
SMOOTH, NOISY = 0.88, 0.85
"""Fractions of `DemoQuality.length_kept`: at least that of smooth paths, and at most that of noisy ones."""
MANY_STATES, GOOD_STATES = 1200, 200
"""With more states than the first, the widest triplet of the midpoint error spans less than a twentieth of a
demonstration; with the second, it spans about a third."""
MANY_VISITED, MANY_STILL = 0.1, 0.3


@dataclass(frozen=True)
class Verdict:
    """A measurement in words; each entry is a sentence."""

    good: tuple[str, ...]
    """What z does well."""
    weak: tuple[str, ...]
    """What z does badly, or what cannot be told."""
    not_supported: tuple[str, ...]
    """Why the demonstrations do not allow more."""
    advice: tuple[str, ...]
    """What to try."""

    def to_dict(self) -> dict[str, tuple[str, ...]]:
        """Return plain data for JSON."""
        found = asdict(self)
        return {"try" if name == "advice" else name: sentences for name, sentences in found.items()}


class _Notes:
    """Sentences under collection."""

    def __init__(self) -> None:
        self.good: list[str] = []
        self.weak: list[str] = []
        self.not_supported: list[str] = []
        self.advice: list[str] = []

    def verdict(self) -> Verdict:
        """The sentences, each once."""
        parts = (self.good, self.weak, self.not_supported, self.advice)
        return Verdict(*(tuple(dict.fromkeys(sentences)) for sentences in parts))


def judge(
    measured: Mapping[str, tuple[Geometry, Geometry]],
    quality: DemoQuality,
    checks: Mapping[str, float | None],
    z_dim: int,
) -> Verdict:
    """Put a measurement into words.

    Args:
        measured: by split, the geometry in z and that of the raw state; the last split is judged.
        quality: what the demonstrations are like.
        checks: the checks by name; None if one does not apply.
        z_dim: number of dimensions of z.
    """
    notes = _Notes()
    name, (z, raw) = list(measured.items())[-1]
    _judge_geometry(notes, z, raw, z_dim)
    _judge_checks(notes, checks)
    if "train" in measured and measured["train"][0].straightness > z.straightness + OVERFIT:
        train = measured["train"][0].straightness
        notes.weak.append(
            f"Training demonstrations are straighter than others ({train:.2f} against "
            f"{z.straightness:.2f}): z fits the training demonstrations rather than the task."
        )
        notes.advice.append("Collect more demonstrations, or train fewer steps (`embed --steps`).")
    if z.num_demos < FEW_MEASURED:
        which = f" of the {name} split" if name in SPLITS else ""
        notes.weak.append(
            f"Only {_counted(z.num_demos, 'demonstration')}{which} could be measured: too few to predict the "
            "metrics of others."
        )
        if name in SPLITS:
            notes.advice.append(
                "`planspace measure --folds 5` measures every demonstration with an embedding that was "
                "trained on the others."
            )
    _judge_demos(notes, quality)
    return notes.verdict()


def _judge_geometry(notes: _Notes, z: Geometry, raw: Geometry, z_dim: int) -> None:
    straight = f"{z.straightness:.2f}, raw state {raw.straightness:.2f}"
    if z.straightness >= NEARLY_STRAIGHT:
        notes.good.append(f"Demonstrations are nearly straight in z (straightness {straight}).")
    elif z.straightness > raw.straightness + STRAIGHTER:
        notes.good.append(f"Demonstrations are straighter in z than in the raw state ({straight}).")
    else:
        notes.weak.append(f"Demonstrations are not straighter in z than in the raw state ({straight}).")
        notes.advice.append("Train longer (`embed --steps`) or with a higher `--linearity`.")
    if z.time_correlation >= FOLLOWS_TIME:
        notes.good.append(f"The distance to the end follows the time left ({z.time_correlation:.2f}).")
    error = f"decoded error {z.decoded_error:.2f}"
    if z.decoded_error <= KEEPS_STATE:
        notes.good.append(f"z keeps the state ({error}).")
    elif z.decoded_error > LOSES_STATE:
        notes.weak.append(f"z has lost most of the state ({error}; a constant z has 1).")
        notes.advice.append("Use a larger `--z-dim`, or leave states that do not matter out of `--columns`.")
    if z.active_dims < z_dim:
        notes.weak.append(f"Only {z.active_dims} of {z_dim} dimensions of z are in use.")
        notes.advice.append("Lower `embed --prior`, or use a smaller `--z-dim`.")


def _judge_checks(notes: _Notes, checks: Mapping[str, float | None]) -> None:
    changes = {
        "a full turn of an angle": checks.get("change_by_a_turn"),
        "another sign of a quaternion": checks.get("change_by_a_sign"),
    }
    for what, change in changes.items():
        if change is None:
            continue
        if change <= SMALL_CHANGE:
            notes.good.append(f"{what.capitalize()} does not move z.")
        else:
            notes.weak.append(
                f"{what.capitalize()} moves z by {change:.2g} standard deviations, but it is the same state."
            )
            notes.advice.append("Train with `embed --inputs trig`, for which such states have one z.")
    outside = checks.get("outside_support")
    if outside is not None and outside > MANY_OUTSIDE:
        notes.weak.append(
            f"{_percent(outside)} of the states are outside of what the training demonstrations cover; there "
            "z is a guess."
        )
        notes.advice.append("Train on demonstrations like these.")


def _judge_demos(notes: _Notes, quality: DemoQuality) -> None:
    if quality.num_demos < FEW_DEMOS:
        notes.not_supported.append(
            f"Too few: {_counted(quality.num_demos, 'demonstration')}. A few hundred are enough for most "
            "tasks."
        )
        notes.advice.append("Collect more demonstrations.")
    _judge_rate(notes, quality)
    if quality.revisiting > MANY_VISITED:
        notes.not_supported.append(
            f"Revisiting: {_percent(quality.revisiting)} of the states are visited again later, and no "
            "straight line passes a point twice."
        )
        notes.advice.append(
            "Divide demonstrations where they repeat, or add a state that tells the passes apart."
        )
    if quality.standing_still > MANY_STILL:
        notes.not_supported.append(
            f"Pauses: {_percent(quality.standing_still)} of the steps hardly move, so z cannot have constant "
            "speed."
        )
        notes.advice.append("Leave out pauses before the import.")
    if quality.off_goal:
        notes.not_supported.append(
            f"Off-goal: {quality.off_goal} of {_counted(quality.num_demos, 'demonstration')} do not end at "
            "their goal."
        )
        notes.advice.append("Leave out failed demonstrations, and end each one where the task ends.")


def _judge_rate(notes: _Notes, quality: DemoQuality) -> None:
    kept = quality.length_kept
    if kept.get(1, 1.0) < NOISY:
        notes.not_supported.append(
            f"Too noisy: without every second state, {_percent(kept[1])} of the length of a demonstration "
            "remains (smooth ones keep over 90 %)."
        )
        smooth = [factor for factor, fraction in kept.items() if fraction >= SMOOTH]
        notes.advice.append(
            f"Thin the recording to {1 / (smooth[0] * quality.step_s):.3g} Hz, where its paths are smooth "
            "(`demos import --rate`), or filter it."
            if smooth
            else "Filter the recording: its paths are not smooth at any lower rate."
        )
    elif quality.num_states > MANY_STATES:
        widest = 2 * quality.spacings_s[-1]
        notes.not_supported.append(
            f"Too fine: {quality.num_states:,} states per demonstration; the widest triplet of the midpoint "
            f"error spans {widest:.3g} s of {quality.num_states * quality.step_s:.3g} s."
        )
        rate = GOOD_STATES / (quality.num_states * quality.step_s)
        notes.advice.append(
            f"Keep about {GOOD_STATES} states of a demonstration (`demos import --rate {rate:.3g}`)."
        )


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _percent(fraction: float) -> str:
    return f"{100 * fraction:.0f} %"
