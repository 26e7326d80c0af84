"""Register table of a serial servo. Pure."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Literal

from twind_drivers.device_registers import unknown_register
from twind_drivers.half_duplex.signed_words import from_word, to_word

TWOS = -1  # sign of two's complement


@dataclass(frozen=True, slots=True)
class MappedRegister:
    """One register."""

    name: str
    address: int
    size: int  # bytes
    sign: int | None  # sign bit; None: unsigned; `TWOS`: two's complement
    least: int
    most: int
    kept: bool  # it survives power-off
    order: Literal["little", "big"] = "little"

    @property
    def key(self) -> str:
        """Its name, which is in snake case."""
        return self.name

    @property
    def end(self) -> int:
        """First address behind it."""
        return self.address + self.size

    @property
    def eeprom(self) -> bool:
        """True if it survives power-off."""
        return self.kept

    @property
    def writable(self) -> bool:
        """True if a write has an effect."""
        return self.least < self.most

    def clip(self, value: int) -> int:
        """Return the nearest value that its bytes can hold."""
        bits = 8 * self.size
        if self.sign == TWOS:
            return max(-(1 << bits - 1), min(value, (1 << bits - 1) - 1))
        most = (1 << (bits if self.sign is None else self.sign)) - 1
        return max(0 if self.sign is None else -most, min(value, most))

    def encode(self, value: int) -> bytes:
        """Return the bytes of a value. Raises OverflowError."""
        if self.sign == TWOS:
            return value.to_bytes(self.size, self.order, signed=True)
        return to_word(value, self.sign, self.size).to_bytes(self.size, self.order)

    def decode(self, data: bytes) -> int:
        """Return the value in the first bytes of `data`."""
        if self.sign == TWOS:
            return int.from_bytes(data[: self.size], self.order, signed=True)
        return from_word(int.from_bytes(data[: self.size], self.order), self.sign)

    def check(self, value: int) -> None:
        """Raise ValueError for a value outside the range, and for a register that is read only."""
        if not self.writable:
            raise ValueError(f"{self.name} is read only")
        if not self.least <= value <= self.most:
            raise ValueError(f"{self.name} = {value} is outside {self.least}..{self.most}")


@dataclass(frozen=True, slots=True)
class RegisterTable:
    """Registers of one kind of servo, by name. `title`: of the kind, for messages."""

    title: str
    registers: Mapping[str, MappedRegister]

    def __contains__(self, name: str) -> bool:
        return name in self.registers

    def __iter__(self) -> Iterator[str]:
        return iter(self.registers)

    def __getitem__(self, name: str) -> MappedRegister:
        """Raise InvalidInput that lists similar names, for an unknown one."""
        found = self.registers.get(name)
        if found is None:
            near = get_close_matches(name.replace(" ", "_"), self.registers, cutoff=0.4)
            raise unknown_register(self.title, name, near)
        return found

    @property
    def is_big_endian(self) -> bool:
        """True where a goal has its high byte first."""
        return "goal_position" in self and self["goal_position"].order == "big"

    def values(self, first: int, data: bytes) -> dict[str, int]:
        """Decode all registers that lie in `data`, read from address `first`."""
        return {
            each.name: each.decode(data[each.address - first :])
            for each in self.registers.values()
            if first <= each.address and each.address + each.size <= first + len(data)
        }


def parse_registers(text: str, kept_end: int) -> dict[str, MappedRegister]:
    """Return the registers of lines `name address size sign least most`.

    Sign bit `-`: none; `2s`: two's complement. least = most: read only. Addresses below `kept_end` survive
    power-off.
    """
    found = {}
    for line in filter(None, text.split("\n")):
        name, address, size, sign, least, most = line.split()
        bit = None if sign == "-" else TWOS if sign == "2s" else int(sign)
        kept = int(address) < kept_end
        found[name] = MappedRegister(name, int(address), int(size), bit, int(least), int(most), kept)
    return found


def spans_of(fields: Sequence[MappedRegister]) -> list[tuple[int, int]]:
    """Return one block (address, size) for the EEPROM area and one for RAM, of those that `fields` lie in."""
    spans = []
    for kept in (True, False):
        own = [each for each in fields if each.kept is kept]
        if own:
            first = min(each.address for each in own)
            spans.append((first, max(each.address + each.size for each in own) - first))
    return spans
