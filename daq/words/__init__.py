"""What Kerntemp says: codes with arguments, put into words by the face that shows them.

A sentence is never built where it arises. There, `say` makes a `Message`, a code with arguments; a file a language
(``en.ftl``, ``de.ftl``) holds the words, with plurals and digits, in the syntax of Project Fluent, which Python
and the page both read. To add a language, add its file. `daq.words.message.words` puts a message into a language;
``str(message)`` is English, for logs, but where a notebook chose another language (`daq.speak`).

Decided 2026-11-22: Fluent, because its two libraries (fluent.runtime, @fluent/bundle) read the same file, and
plural rules come with them. The catalogues are read on first use, fluent with them: nothing is slower to
start for them.
"""

from daq.words.message import Argument, Message, say, spoken

__all__ = ["Argument", "Message", "say", "spoken"]
