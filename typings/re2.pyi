from collections.abc import Iterator

class error(Exception): ...

class Options:
    max_mem: int
    posix_syntax: bool
    log_errors: bool
    never_nl: bool
    never_capture: bool
    one_line: bool

class _Match:
    def group(self) -> bytes: ...

class _Regexp:
    @property
    def programsize(self) -> int: ...
    def finditer(self, text: bytes) -> Iterator[_Match]: ...

def compile(pattern: str, options: Options | None = None) -> _Regexp: ...
def purge() -> None: ...
