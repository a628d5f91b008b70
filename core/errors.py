# SPDX-License-Identifier: GPL-3.0-or-later
"""The ways a command can end badly, each with its exit status."""


class IrgsppError(Exception):
    """A failure that is told to the user in one line (exit status 1)."""

    exit_status = 1


class InputError(IrgsppError):
    """Bad input or usage (exit status 2): where it is, what is wrong, what to do about it."""

    exit_status = 2

    def __init__(self, where: object, what: str, fix: str = "") -> None:
        self.where, self.what, self.fix = _short(str(where), 1000), _short(what, 800), _short(fix, 2000)
        super().__init__(" ".join(f"{self.where}: {self.what}{'; ' + self.fix if fix else ''}".split()))


def _short(text: str, most: int) -> str:
    """The text without its middle where it is longer: what stands in a damaged file may be endless."""
    return text if len(text) <= most else f"{text[: most // 2]} ... {text[-most // 3 :]}"


class Cancelled(IrgsppError):
    """The user stopped the work; what is done so far has been saved (exit status 130)."""

    exit_status = 130
