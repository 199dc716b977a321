"""The command line: ``onepulse check LOG``, ``onepulse identify LOG --robot arm.toml -o
found.json``, ...
"""

from ctc.commandline.controller_commands import stated_uncertainty
from ctc.commandline.inputs import Answer, path_of, records_of
from ctc.commandline.main import command_parser, main
from ctc.commandline.plan import typed_arguments
from ctc.commandline.words import in_the_shell

__all__ = [
    "Answer",
    "command_parser",
    "in_the_shell",
    "main",
    "path_of",
    "records_of",
    "stated_uncertainty",
    "typed_arguments",
]
