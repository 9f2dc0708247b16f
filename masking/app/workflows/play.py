"""The verb play: a model under sliders, its motion drawn again at once."""

from __future__ import annotations

from pathlib import Path

from masking.model.modelling.model import Model, load_model
from masking.reports.play_page import Playground, PlayPage


def play(model: str | Path | Model, *, duration: float | None = None, port: int = 0) -> PlayPage:
    """Show a model on a local page: sliders of its parameters and initial values, and its motion, drawn again at once.

    Args:
        model: a name that `masking list` shows, or a YAML file; in Python, a `Model`, too.
        duration: of the motion at first, in s, or in units of time of a model without units; by default some periods of
            its slowest mode.
        port: of the page on this machine; by default a free one.

    Returns:
        the page, which a notebook shows. It ends with the process, or as a context: `with masking.play("duffing"):`.

    Raises:
        MaskingError: the declaration is wrong, the model cannot move as it is declared, or the port is taken.
    """
    return PlayPage(Playground(model if isinstance(model, Model) else load_model(model), duration), port)
