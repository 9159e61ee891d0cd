"""Root of the ``register-confidence`` command's config."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from depthcli.core.bound import VolumeBound
from depthcli.core.root_config import RootConfig
from depthcli.methods.registration.pipeline import Pipeline
from depthcli.methods.registration.pipeline.search import RegistrationSearch


class RegisterConfidenceConfig(RootConfig):
    """A pipeline and its parameters, side by side."""

    command: ClassVar[str] = "register-confidence"

    pipeline: Pipeline = Field(RegistrationSearch(), description="the data flow from registered pair to expected error")
    bound: VolumeBound = Field(VolumeBound(), description="bound of the errors and probability of small ones")
    field: str = Field(
        "auto",
        pattern="^(auto|itk|ants|niftyreg|voxels)$",
        description="convention of displacement files; auto: what the header says, checked against the others",
    )
    neurological: bool = Field(False, description="pictures have the patient's right on the right, else on the left")
