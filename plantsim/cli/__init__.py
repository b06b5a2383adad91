"""The command line: thin; every command calls a function that Python users call too.

One file a command; importing it here adds the command, in this order.
"""

from plantsim.cli import demo, grow, mesh, push, touch, estimate, view, dataset, doctor  # noqa: F401, I001  in this order
from plantsim.cli.app import main as main
