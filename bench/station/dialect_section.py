"""Sections of the station file that name a dialect, which adds keys of its own to them."""

from __future__ import annotations

from functools import cache
from typing import Any, ClassVar, Literal, Self, cast

from pydantic import Field, GetJsonSchemaHandler, ValidationError, create_model, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.station.field_types import Identity, Port
from gyrobench.drivers.chamber import ChamberDialect
from gyrobench.drivers.dialects import installed, load
from gyrobench.drivers.rate_table import TableDialect

Dialect = TableDialect[Any] | ChamberDialect[Any]


class DialectSection(StrictModel):
    """An instrument on a serial port.

    What is read from a file is of a class that has the dialect's own keys as well, and so is an
    instance of the dialect's options.
    """

    #: Group of the installed dialects, and what each of them is.
    group: ClassVar[str]
    kind: ClassVar[type[Dialect]]

    dialect: str = Field(description="command language")
    identity: Identity = ""
    port: Port
    baudrate: int | None = Field(
        default=None, gt=0, description="bit/s of a serial device; the dialect's usual one if not given"
    )
    parity: Literal["N", "E", "O"] | None = Field(
        default=None,
        description="none, even or odd, of a serial device; the dialect's usual one if not given",
    )

    @property
    def installed_dialect(self) -> Dialect:
        """The dialect itself."""
        return load(self.group, self.dialect, self.kind)

    @model_validator(mode="wrap")
    @classmethod
    def _with_the_keys_of_its_dialect(cls, data: Any, handler: Any) -> Self:
        is_complete = "dialect" in cls.model_fields and cls.model_fields["dialect"].annotation is not str
        if is_complete or not isinstance(data, dict):
            return cast(Self, handler(data))
        if "dialect" not in data:
            raise _wrong(cls, "missing", f"the key 'dialect' is missing; {_installed(cls)}", data)
        name = data["dialect"]
        if not isinstance(name, str):
            raise _wrong(cls, "dialect", f"a dialect is a name; {_installed(cls)}", name)
        try:
            complete = section_of(cls, name)
        except DocumentError as error:
            raise _wrong(cls, "dialect", str(error), name) from error
        return cast(Self, complete.model_validate(data))

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        if cls.model_fields["dialect"].annotation is not str:
            return handler(core_schema)
        complete = [section_of(cls, name) for name in _that_load(cls)]
        return {"oneOf": [handler(section.__pydantic_core_schema__) for section in complete]}


@cache
def section_of(section: type[DialectSection], name: str) -> type[DialectSection]:
    """Class of a section with the keys of one dialect added.

    Raises
    ------
    DocumentError
        There is no such dialect, or its keys can't be added.
    """
    options: type[StrictModel] = load(section.group, name, section.kind).options
    taken = sorted(options.model_fields.keys() & section.model_fields.keys())
    if taken:
        raise DocumentError(
            f"the dialect {name!r} redefines common keys ({', '.join(taken)}); report this to the package's "
            "author"
        )
    dialect: Any = (Literal[name], Field(description="command language"))
    bases: Any = (options, section)  # a message names the section's own keys first
    complete = create_model(f"{section.__name__}_{name}", __base__=bases, dialect=dialect)
    return cast(type[DialectSection], complete)


def _that_load(section: type[DialectSection]) -> list[str]:
    names = []
    for name in installed(section.group):
        try:
            section_of(section, name)
        except DocumentError:
            continue  # a broken package of somebody else keeps its keys to itself
        names.append(name)
    return names


def _installed(section: type[DialectSection]) -> str:
    return f"installed: {', '.join(installed(section.group))}"


def _wrong(section: type[DialectSection], kind: str, message: str, found: Any) -> ValidationError:
    # A message may have braces, which the error would take for places of its context.
    escaped = message.replace("{", "{{").replace("}", "}}")
    detail = InitErrorDetails(
        type=PydanticCustomError(cast(Any, kind), cast(Any, escaped)), loc=("dialect",), input=found
    )
    return ValidationError.from_exception_data(section.__name__, [detail])
