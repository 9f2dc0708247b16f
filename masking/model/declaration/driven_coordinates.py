"""Which coordinates of a rig a transform drives, and which stay as the rig has them (passive ones)."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from masking.model.declaration.schema import Transform


def selected(rig: Sequence[str], virtual: Sequence[str]) -> tuple[int, ...] | None:
    """Indices of the rig coordinates that the identity takes; None where it cannot tell.

    Virtual coordinates that have the names of rig coordinates are these; others are all of the rig's, in order.
    """
    if all(name in rig for name in virtual):
        return tuple(rig.index(name) for name in virtual)
    return tuple(range(len(rig))) if len(rig) == len(virtual) else None


def passive(transform: Transform, rig: Sequence[str], virtual: Sequence[str]) -> tuple[str, ...]:
    """Names of the rig coordinates that no virtual coordinate stands for, in the rig's order.

    They are those that the transform does not name; where it names more coordinates than it has rows, the last of these
    are passive, too.
    """
    count = len(rig) - len(virtual)
    if count <= 0:
        return ()
    used = _used(transform, rig, virtual)
    others = [name for name in rig if name not in used]
    others += [name for name in reversed(rig) if name in used][: count - len(others)] if len(others) < count else []
    return tuple(name for name in rig if name in others)


def _used(transform: Transform, rig: Sequence[str], virtual: Sequence[str]) -> Collection[str]:
    """Names of the rig coordinates that a transform depends on."""
    if transform.expressions is not None:
        return {name for entry in transform.expressions.values() for name in entry.names}
    if transform.matrix is not None:
        rows = [[entry.text.strip() not in {"0", "0.0"} for entry in row] for row in transform.matrix]
        return {name for i, name in enumerate(rig) if any(i < len(row) and row[i] for row in rows)}
    return {rig[i] for i in selected(rig, virtual) or ()}
