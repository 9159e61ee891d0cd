"""Root of the ``register-confidence`` command's config."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from depthcli.methods.registration.pipeline import RegistrationConfidence


class RegisterConfidenceConfig(RegistrationConfidence):
    """The fields of the method, side by side."""

    field: str = Field(
        "auto",
        pattern="^(auto|itk|ants|niftyreg|voxels)$",
        description="convention of displacement files; auto: what the header says, checked against the others",
    )
    neurological: bool = Field(False, description="pictures have the patient's right on the right, else on the left")
    run: dict[str, Any] | None = Field(default=None, exclude=True, description="How a run was made; ignored.")
