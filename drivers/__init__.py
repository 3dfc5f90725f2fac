"""One instrument per file: drivers talk bytes and know nothing of procedures or analysis.

Every driver module gives the same four things:

- `Settings`: the keys of its entry under `instruments:` in a bench file (besides `driver`), units in the field's text;
- `connect(name, settings, room)`: opens the link and changes nothing on the instrument;
- `MESSAGES`: every message the driver can send, with representative values filled in;
- a driver object with `identify()`, `settings()`, `close()`, and `make_safe()` where it energises something.

`links` holds the two ways bytes travel: VISA (GPIB through a Prologix gateway, VXI-11, raw sockets) and serial lines.
Inside, everything is SI and plain floats; a volt of the analyzer's source is a peak volt into 50 Ω, as programmed.
Every failure is an error of `rig.errors` that shows both halves of the exchange.
"""
