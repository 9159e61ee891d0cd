from pydantic import Field

from depthcli.methods.stereo.cost import Cost
from tests.core.toys import Toy


class Chest(Toy):
    """A chest that holds methods of another family."""

    cost: Cost = Field(description="what it costs")
    parts: tuple[Cost, ...] = ()
    width: int | tuple[int, int] = Field(3, description="width, pixels")
    mode: str | None = None

    def __call__(self) -> None: ...
