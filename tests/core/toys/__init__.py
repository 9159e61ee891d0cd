"""A family of methods to test the config mechanism with."""

from typing import Annotated

from depthcli.core.method import Method, method_of


class Toy(Method):
    def __call__(self) -> None: ...


AnyToy = Annotated[Toy, *method_of("tests.core.toys", key="toy")]
