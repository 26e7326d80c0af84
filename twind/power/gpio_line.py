"""Line of a GPIO chip by `gpiod`, which only a robot with such a line needs."""

from typing import Any


class GpioLine:
    """One requested line. All methods raise OSError."""

    def __init__(self, chip: str, line: int, *, output: bool, active_low: bool = False) -> None:
        """Request `line` of `chip`: an inactive output, or an input with pull-up. Raises OSError."""
        try:
            import gpiod  # noqa: PLC0415 - an optional extra
            from gpiod.line import Bias, Direction, Value  # noqa: PLC0415
        except ImportError as error:
            raise OSError(f"{error}; it comes with the extra gpio: `make extras EXTRAS=gpio`") from None
        direction = Direction.OUTPUT if output else Direction.INPUT
        bias = Bias.AS_IS if output else Bias.PULL_UP
        settings = gpiod.LineSettings(direction=direction, bias=bias, active_low=active_low)
        self._active = Value.ACTIVE
        self._inactive = Value.INACTIVE
        self._line = line
        try:
            self._request: Any = gpiod.request_lines(chip, consumer="twind", config={line: settings})
        except ValueError as error:  # a line number that the chip lacks
            raise OSError(str(error)) from None

    def set(self, on: bool) -> None:
        """Set an output active or inactive."""
        self._request.set_value(self._line, self._active if on else self._inactive)

    def is_active(self) -> bool:
        """Return the state of an input."""
        return bool(self._request.get_value(self._line) == self._active)

    def close(self) -> None:
        """Release the line."""
        self._request.release()
