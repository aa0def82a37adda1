"""How a model of an SDF file asks to move, in a word of ours inside its <model>.

```xml
<model name="cart_1" xmlns:zensim="urn:zensim">
  <zensim:dynamics>auto</zensim:dynamics>
</model>
```
"""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

from zensim.proto.messages.model_messages import Dynamics
from zensim.sim_server.description.sdf_places import own_word
from zensim.sim_server.description.wording import shown

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

    from zensim.sim_server.description.report import Report


def read_dynamics(model: Element, report: Report) -> Dynamics:
    """Read which dynamics a <model> asks for; empty = none, also where the word is none."""
    words = [(child.text or "").strip() for child in model if own_word(child) == "dynamics"]
    if not words:
        return ""
    for known in get_args(Dynamics):
        if known and known == words[-1]:
            return known  # type: ignore[no-any-return]
    kinds = ", ".join(known for known in get_args(Dynamics) if known)
    report.suspicious("dynamics", f"{shown(words[-1])} is unknown; use {kinds}")
    return ""
