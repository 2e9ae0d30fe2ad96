"""Why a text is no XML, in the words of its author."""

from __future__ import annotations

import re
from xml.parsers import expat

from uqharness.errors import BadInputError


def malformed_xml(raw: bytes, where: str) -> BadInputError:
    """Return the error of a malformed XML file, with its line and the mend.

    Parameters
    ----------
    raw : bytes
        Content of the file.
    where : str
        The file, as messages name it.

    Examples
    --------
    >>> print(malformed_xml(b"<a>\\n<b>\\n</a>", "x.xml"))
    x.xml:3: not well-formed XML: </a> stands before the end of <b> (line 2); write </b> first
    """
    parser = expat.ParserCreate()
    opened: list[tuple[str, int]] = []
    parser.StartElementHandler = lambda tag, _: opened.append((tag, parser.CurrentLineNumber))
    parser.EndElementHandler = lambda _: opened.pop()
    try:
        parser.Parse(raw, True)
    except expat.ExpatError as error:
        text = expat.ErrorString(error.code).replace("not well-formed (", "unexpected character (")
        rest = raw[parser.ErrorByteIndex :]
        line = raw[: parser.ErrorByteIndex].rpartition(b"\n")[2] + rest.partition(b"\n")[0]
        if text == "mismatched tag":
            closing = rest.partition(b">")[0].decode(errors="replace").strip("</ ")
            tag, start = opened[-1]
            text = f"</{closing}> stands before the end of <{tag}> (line {start}); write </{tag}>"
            text += " first" if any(closing == name for name, _ in opened) else f" for </{closing}>"
        elif text == "no element found" and opened:
            tag, start = opened[-1]
            text = f"the file ends before <{tag}> (line {start}) does; write </{tag}>"
        elif rest[:1] > b"\x7f":
            text = f"the byte 0x{rest[0]:X} is no UTF-8; save the file as UTF-8, or begin it with"
            text += ' <?xml version="1.0" encoding="ISO-8859-1"?>'
        elif re.search(rb"&(?![\w#]+;)", line):
            text += "; write &amp; for &"
        elif re.search(rb"<(?![\w/!?])", line):
            text += "; write &lt; for <, or lt and le in a condition"
        elif re.search(rb"\w=[^'\"\s]", line):
            text += '; write the value of an attribute in quotes, such as unit="FT"'
        elif b"--" in line:
            text += "; a comment must not contain --"
        return BadInputError(f"{where}:{error.lineno}: not well-formed XML: {text}")
    except (ValueError, LookupError) as error:  # an encoding that Python does not know
        return BadInputError(f'{where}:1: not readable as XML: {error}; write encoding="UTF-8"')
    return BadInputError(f"{where}:1: not well-formed XML")
