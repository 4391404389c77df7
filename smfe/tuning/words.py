"""The answer in sentences, and the gains as a file that a campaign or scenario takes."""

from __future__ import annotations

from process.drive.servo import Servo
from smfe.tuning.result import GainSet, Tuning
from smfe.tuning.rules import RULES
from smfe.tuning.task import LIMIT_WORDS, Task


def amount(task: Task, value: float) -> str:
    """Return what is maximised, with its unit."""
    if task.goal.kind == "removal_rate":
        return f"{6e7 * value:.4g} cm3/min"
    return f"{1e3 * value:.4g} mm" if value < RULES.deepest else "no limit"


def values(one: GainSet) -> dict[str, float]:
    """Return what may be limited by its name and unit, in that unit."""
    return {f"{name}_{LIMIT_WORDS[name][2]}": LIMIT_WORDS[name][3] * value for name, value in one.values.items()}


def gains(v: Servo) -> str:
    """Return the gains of an axis."""
    ahead = f", feed-forward {v.feed_forward:.3g}" if v.feed_forward else ""
    return f"Kp {v.Kp:.4g} N s/m, Ti {1e3 * v.Ti:.4g} ms, Kv {v.Kv:.4g} 1/s{ahead}"


def summary(found: Tuning) -> list[str]:
    """Return the answer, a sentence a line: gains, what they are worth, what the present ones lack."""
    task, best = found.task, found.best
    lines = [f"axis {axis}: {gains(v)}" for axis, v in best.servos.items()]
    said = f"{task.goal.words}: {amount(task, best.goal)}"
    if task.robust:
        said += (
            f" at worst with all modes moved by up to {100 * task.robust:.3g} % either way, "
            f"{amount(task, best.nominal)} where they are"
        )
    lines.append(said)
    lines.append("limits: " + ", ".join(_kept(task, best)))
    lines.append(f"{task.move.words}: {1e6 * best.tracking_error:.4g} um")
    for one in (*found.present, *([found.rule] if found.rule else [])):
        lines.append(_beside(found, one))
    if len(found.frontier) > 1:
        lines.append(_compromise(found))
    return [*lines, *found.notes]


def _kept(task: Task, one: GainSet) -> list[str]:
    out = []
    for name, limit in vars(task.limits).items():
        if limit is None:
            continue
        what, side, unit, factor = LIMIT_WORDS[name]
        out.append(f"{what} {factor * one.values[name]:.3g} {unit} ({side} {factor * limit:.3g})")
    return out or ["none"]


def _beside(found: Tuning, one: GainSet) -> str:
    what = "the rule with one bandwidth" if one is found.rule else one.name
    if one.goal == 0.0:
        return f"{what}: {'; '.join(one.misses) or 'nothing is stable'}"
    short = 100.0 * found.shortfall(one)
    by = f"falls short by {short:.0f} %" if short >= -0.5 else "more than the answer"
    missed = f", but misses: {'; '.join(one.misses)}" if one.misses else ""
    error = f"tracking error {1e6 * one.tracking_error:.4g} um"
    return f"{what}: {amount(found.task, one.goal)}, {by}; {error}{missed}"


def _compromise(found: Tuning) -> str:
    one = found.frontier[0]
    return (
        f"depth against tracking: from {amount(found.task, one.goal)} at {1e6 * one.tracking_error:.3g} um to "
        f"{amount(found.task, found.best.goal)} at {1e6 * found.best.tracking_error:.3g} um; "
        f"{len(found.frontier)} compromises are listed"
    )


def gains_text(found: Tuning) -> str:
    """Return the gains as tables of a campaign or scenario."""
    lines = [f"# {found.task.goal.words}: {amount(found.task, found.best.goal)}", ""]
    for axis, v in found.servos.items():
        lines += [
            f"[machine.axis.{axis}.controllers.tuned]",
            f'Kp = "{v.Kp:.6g} N s/m"',
            f'Ti = "{1e3 * v.Ti:.6g} ms"',
            f'Kv = "{v.Kv:.6g} 1/s"',
            *([f'delay = "{1e3 * v.delay:.6g} ms"'] if v.delay else []),
            f"feed_forward = {v.feed_forward:.6g}",
            "",
        ]
    return "\n".join(lines)
