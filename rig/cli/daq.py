"""The acquisition service on the PC-104 machine."""

from __future__ import annotations

import click

from rig.cli.options import json_option, print_json


@click.group()
def daq() -> None:
    """The acquisition service that runs beside the board, on the PC-104 machine."""


@daq.command()
@click.option("--device", default="/dev/comedi0", show_default=True, help="comedi device of the board.")
@click.option("--serial", default="not stated", show_default=True, help="Serial number on the board's label.")
@click.option("--library", default="libcomedi.so.0", show_default=True, help="comedi library.")
@click.option(
    "--host", default="127.0.0.1", show_default=True, help="Address to listen on; use a private interface only."
)
@click.option(
    "--port", default=30431, show_default=True, type=click.IntRange(0, 65535), help="TCP port; 0 takes a free one."
)
@json_option
def serve(device: str, library: str, serial: str, host: str, port: int, as_json: bool) -> None:
    """Serve the board over TCP until Ctrl-C.

    \f
    How it is set up: [run the acquisition service](../how-to/run-the-daq-service.md).
    """
    import importlib

    comedi = importlib.import_module("drivers.comedi")
    service = importlib.import_module("drivers.daq_service")

    def announce(where: str, control: int) -> None:
        if as_json:
            print_json({"host": where, "port": control, "device": device})
        else:
            click.echo(f"serving {device} at {where}:{control} until Ctrl-C; next, on the laptop: rig bench check")

    board = comedi.open_board("board", comedi.Settings(device=device, library=library, serial=serial))
    service.serve(board, host, port, announce=announce)
