"""The command `matiere`: finds the subcommand, imports only that, and words its errors.

Exit codes: 0 done, 1 failed, 2 bad input, 130 interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import typer

from matiere.errors import MatiereError, SceneValidationError
from matiere.service.commands import COMMANDS

EXTRA_HINT = "this command needs more packages: pip install 'matiere[service]'"


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command line; never returns."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        make_app(arguments)(args=arguments, prog_name="matiere")
    except SceneValidationError as error:
        complain("\n".join(line for line in str(error).splitlines()))
        sys.exit(2)
    except MatiereError as error:
        complain(str(error))
        sys.exit(2)
    except ModuleNotFoundError as error:
        if (error.name or "matiere").startswith("matiere"):
            raise
        complain(f"{EXTRA_HINT} ({error.name} is missing)")
        sys.exit(1)
    except OSError as error:
        complain(f"{error.filename or 'a file or connection'}: {error.strerror or error}")
        sys.exit(1)
    except KeyboardInterrupt:
        complain("interrupted")
        sys.exit(130)
    sys.exit(0)


def make_app(arguments: Sequence[str]) -> typer.Typer:
    """Return the typer app in which only the command that `arguments` name is real."""
    app = typer.Typer(
        help="Render materials, and know the error of every image.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
    )
    app.callback(invoke_without_command=True)(_top)
    chosen = next((word for word in arguments if not word.startswith("-")), None)
    for name, (target, line) in COMMANDS.items():
        function = _load(target) if name == chosen else _placeholder
        app.command(name, help=None if name == chosen else line)(function)
    return app


def _top(
    context: typer.Context,
    version: bool = typer.Option(False, "--version", help="Print the version and exit."),
) -> None:
    if version:
        from matiere import __version__

        typer.echo(f"matiere {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def _placeholder() -> None:
    """Stand for a command that was not asked for."""


def _load(target: str) -> Callable[..., Any]:
    module, function = target.split(":")
    try:
        loaded = import_module(f"matiere.service.commands.{module}")
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("matiere"):
            raise
        complain(f"{EXTRA_HINT} ({error.name} is missing)")
        sys.exit(1)
    made: Callable[..., Any] = getattr(loaded, function)
    return made


def complain(message: str) -> None:
    """Print an error to stderr."""
    typer.echo(message, err=True)


if __name__ == "__main__":
    main()
