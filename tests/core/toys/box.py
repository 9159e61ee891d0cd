from typing import ClassVar

from pydantic import Field

from tests.core.toys import Toy


class Box(Toy):
    """A box."""

    renamed: ClassVar[dict[str, str]] = {"heft": "weight"}

    size: tuple[int, int] = Field((3, 5), description="width and height, pixels")
    weight: float = Field(1e-6, gt=0, description="weight, kg")

    def __call__(self) -> None: ...
