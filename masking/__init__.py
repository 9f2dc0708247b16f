"""Make an actuated rig move as if it were another machine.

Four objects carry the package:

* `Model`: a declared system, its equations symbolic when looked at and compiled when run;
* `Controller`: the control law that makes one model move as another, in blocks L, D, G and T;
* a plant: what is out there, simulated or real, declared in a plant file;
* `Recording`: the series of one run and the manifest that says what they are, in one folder on disk.

Each verb of the command line is a function here: `list`, `show`, `check`, `schema`, `run`, `report`,
`identify`, `measure`, `discover`, `refine`, `stability`.

    >>> import masking
    >>> recording = masking.run("duffing")
    >>> max(recording.manifest["masking_error"].values()) < 1e-6
    True
"""

from __future__ import annotations

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "control.closed_loop": ["ClosedLoop"],
        "control.law": ["Controller"],
        "errors": [
            "ActuationError",
            "DeclarationError",
            "IntegrationError",
            "MaskingError",
            "ModelError",
            "RecordError",
            "SingularityError",
        ],
        "runs.experiment": ["Experiment"],
        "modelling.model": ["Model", "load_model"],
        "records.recording": ["Recording"],
        "workflows.verbs": [
            *("check", "discover", "identify", "list", "measure", "refine", "report", "run", "schema", "show"),
            "stability",
        ],
    },
)
