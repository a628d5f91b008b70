# SPDX-License-Identifier: GPL-3.0-or-later
"""The ways a command can end badly, each with its exit status."""


class IrgsppError(Exception):
    """A failure that is told to the user in one line (exit status 1)."""

    exit_status = 1


class InputError(IrgsppError):
    """Bad input or usage (exit status 2): where it is, what is wrong, what to do about it."""

    exit_status = 2

    def __init__(self, where: object, what: str, fix: str = "") -> None:
        self.where, self.what, self.fix = str(where), what, fix
        super().__init__(" ".join(f"{where}: {what}{'; ' + fix if fix else ''}".split()))


class Cancelled(IrgsppError):
    """The user stopped the work; what is done so far has been saved (exit status 130)."""

    exit_status = 130
