"""Control tables of the vendor, read from the files of the installed `dynamixel-sdk` package.

The SDK's code is never imported: its `.model` files are text. They contain address and size of every register
of every model. Sign, access and ranges come from `register_rules.py`.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from importlib import metadata
from pathlib import Path
from types import MappingProxyType

from twind_drivers.device_registers import unknown_register
from twind_drivers.dynamixel.dynamixel_models import ModelCapabilities, facts
from twind_drivers.dynamixel.register_rules import RegisterRule, rule

# In the e-manual (XL330 page; X430/X540 from firmware 45), missing in the vendor's X files. The first can
# switch torque on at boot, so it is always read; older firmware returns 0 there inside a block.
SUPPLEMENT = (("Startup Configuration", 60, 1), ("Backup Ready", 147, 1))

# Names of the Y series for registers that the others have under another name.
Y_NAMES = {
    "Error Code": "Hardware Error Status",
    "Present Motor Temperature": "Present Temperature",
    "Motor Temperature Limit": "Temperature Limit",
    "Baud Rate (Bus)": "Baud Rate",
}
# Addresses of its EEPROM (e-manual, column "Area"); gains and profiles in between are "Hybrid".
Y_EEPROM = (range(8), range(10, 15), range(32, 140), range(256, 512))

# The first PRO servos (e-manual, dxl/pro/h54-200-s500-r and others) have no file in the package.
PRO_R = re.compile(r"[hlm](42|54)_\d+_s\d+_r")
PRO_R_FAMILY = "a PRO -R has no bus watchdog: use a bus of kind dynamixel2_unwatched"


@dataclass(frozen=True, slots=True)
class TableRegister:
    """Register of one model."""

    name: str  # spelling of the vendor's table: "Goal Position"
    key: str  # snake case: "goal_position"
    address: int
    size: int  # bytes
    eeprom: bool  # survives power-off, writable only while torque is off
    rule: RegisterRule

    @property
    def end(self) -> int:
        """First address behind the register."""
        return self.address + self.size

    def decode(self, data: bytes) -> int:
        """Return the value of its `size` bytes, little-endian, signed where the register is.

        Error codes become the bits that other models have.
        """
        value = int.from_bytes(data[: self.size], "little", signed=self.rule.signed)
        return value if self.rule.codes is None else self.rule.codes[value]

    def encode(self, value: int) -> bytes:
        """Return its bytes for `value`. Raises OverflowError if they cannot hold it."""
        return value.to_bytes(self.size, "little", signed=self.rule.signed)

    @property
    def bounds(self) -> tuple[int, int]:
        """Smallest and largest value that may be written."""
        bits = 8 * self.size
        low = -(1 << (bits - 1)) if self.rule.signed else 0
        high = low + (1 << bits) - 1
        lower = self.rule.lower
        upper = self.rule.upper
        return (low if lower is None else lower, high if upper is None else upper)

    def takes(self, value: int) -> bool:
        """Return True if `value` is in the range of this register, writable or not."""
        lower, upper = self.bounds
        return lower <= value <= upper and (self.rule.values is None or value in self.rule.values)

    def check(self, value: int) -> None:
        """Raise ValueError, with register, value and bound, if `value` may not be written."""
        if not self.rule.writable:
            raise ValueError(f"{self.name} (address {self.address}) is read-only")
        lower, upper = self.bounds
        if not lower <= value <= upper:
            raise ValueError(f"{self.name} (address {self.address}): {value} is outside {lower}..{upper}")
        if not self.takes(value):
            known = sorted(self.rule.values or ())
            raise ValueError(
                f"{self.name} (address {self.address}): {value} is not one of {known} of this model"
            )


@dataclass(frozen=True, slots=True)
class ControlTable:
    """Control table of one model."""

    number: int
    model: str  # "XM430-W350"
    stem: str  # the vendor's file: "xm430_w350"
    fields: Mapping[str, TableRegister]  # by key
    # Addresses that an order may write. No indirect data: it may be mapped to a goal register.
    writable: frozenset[int]

    def __getitem__(self, name: str) -> TableRegister:
        """A register by its name, in either spelling, or its address: "11". Raises InvalidInput."""
        key = snake(name)
        if key in self.fields:
            return self.fields[key]
        for field in self.fields.values() if key.isdecimal() else ():
            if field.address == int(key):
                return field
        raise unknown_register(self.model, name, _nearest(key, self.fields))

    def place(self, name: str) -> str:
        """Return a register with its address in this model, for messages: "operating_mode (11)"."""
        return f"{name} ({self[name].address})"

    @property
    def facts(self) -> ModelCapabilities:
        """Capabilities of the model. Raises KeyError for a model whose manual page has not been read."""
        return facts(self.stem)

    @property
    def codes_errors(self) -> bool:
        """True: its hardware error register holds one code; False: it holds a bit for each error."""
        return self["hardware_error_status"].rule.codes is not None

    def __contains__(self, name: str) -> bool:
        """Return True if there is a register of that name."""
        return snake(name) in self.fields

    def __iter__(self) -> Iterator[str]:
        return iter(self.fields)


@cache
def snake(name: str) -> str:
    """Return a name in snake case: "Secondary(Shadow) ID" -> "secondary_shadow_id"."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


@cache
def models() -> Mapping[str, int]:
    """Return the model numbers of the vendor's index by name: {"XM430-W350": 1020, ...}."""
    return MappingProxyType({_model(stem): number for number, stem in _index().items()})


def number_of(name: str) -> int:
    """Return the model number of "XM430-W350"; case and a trailing connector letter do not matter.

    Raises KeyError that lists the near names.
    """
    stems = _numbers()
    key = snake(name)
    for candidate in (key, re.sub(r"_[tr]$", "", key)):
        if candidate in stems:
            return stems[candidate]
    if PRO_R.fullmatch(key):
        raise KeyError(f"{name} is not driven here: {PRO_R_FAMILY}")
    near = _nearest(key, {stem: _model(stem) for stem in stems})
    known = f"; near: {', '.join(near)}" if near else f": known are {', '.join(models())}"
    raise KeyError(f"no Dynamixel model {name!r}{known}")


@cache
def table(number: int, firmware: int = 0) -> ControlTable:
    """Return the table of a model number. X330 from firmware 52 have another indirect layout.

    Raises KeyError for a number that the vendor's index does not have.
    """
    stem = _index().get(number)
    if stem is None:
        raise KeyError(f"model number {number} is not in the vendor's tables")
    newer = f"{stem}_fw52"
    if firmware >= 52 and (model_folder() / f"{newer}.model").exists():
        stem = newer
    rows = _rows(stem)
    if stem.startswith(("x", "2x")) and stem != "xl320":
        known = {snake(name) for name, _, _ in rows}
        rows += [row for row in SUPPLEMENT if snake(row[0]) not in known]
    is_y = stem.startswith("ym")
    if is_y:
        rows += [(Y_NAMES[name], address, size) for name, address, size in rows if name in Y_NAMES]
    torque = min(address for name, address, _ in rows if snake(name) == "torque_enable")
    eeprom = Y_EEPROM if is_y else (range(torque),)
    fields = {
        (key := snake(name)): TableRegister(
            name, key, address, size, any(address in each for each in eeprom), rule(stem, key)
        )
        for name, address, size in rows
    }
    writable = {at for each in fields.values() if each.rule.writable for at in range(each.address, each.end)}
    mapped = {each.address for key, each in fields.items() if key.startswith("indirect_data")}
    allowed = frozenset(writable - mapped)
    return ControlTable(number, _model(_index()[number]), stem, MappingProxyType(fields), allowed)


@cache
def model_folder() -> Path:
    """Folder of the control tables of dynamixel-sdk."""
    return Path(str(metadata.distribution("dynamixel-sdk").locate_file("dynamixel_easy_sdk/control_table")))


@cache
def _numbers() -> Mapping[str, int]:
    return MappingProxyType({stem: number for number, stem in _index().items()})


@cache
def _index() -> Mapping[int, str]:
    lines = (model_folder() / "dynamixel.model").read_text("utf-8").splitlines()[1:]
    pairs = (line.split() for line in lines if line.strip())
    return MappingProxyType({int(number): file.removesuffix(".model") for number, file in pairs})


def _rows(stem: str) -> list[tuple[str, int, int]]:
    """(name, address, size) of a file's section [control table]."""
    text = (model_folder() / f"{stem}.model").read_text("utf-8")
    section = text.partition("[control table]")[2].strip().splitlines()[1:]
    rows = (line.split("\t") for line in section if line.strip())
    return [(name.strip(), int(address), int(size)) for address, size, name in rows]


def _model(stem: str) -> str:
    return stem.upper().replace("_", "-")


def _nearest(key: str, names: Mapping[str, object]) -> list[str]:
    near = get_close_matches(key, names, n=3, cutoff=0.6)
    return [str(names[each]) if isinstance(names[each], str) else each for each in near]
