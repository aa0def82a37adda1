"""`python -m benchmarks.settings_page`: write the table of settings in docs/settings.md."""

from typing import Final

from benchmarks.machine import ROOT
from zensim.proto.settings.deployment_settings import ServeSettings, UpSettings
from zensim.proto.settings.server_settings import WorldKeywords
from zensim.proto.settings.setting import (
    SettingField,
    describe_range,
    list_settings,
    spell_flags,
    write_help,
)

PAGE: Final = ROOT / "docs" / "settings.md"
BEGIN, END = "<!-- settings: begin -->\n", "<!-- settings: end -->\n"
HEAD: Final = (
    "| option of `up` | `serve`, too | key of scenario files | keyword of `World`, `launch` | "
    "default | meaning |\n|---|---|---|---|---|---|\n"
)


def main() -> None:
    """Write the table."""
    PAGE.write_text(replace_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


def replace_table(page: str) -> str:
    """Replace the table of the page by that of the settings."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    rows = "".join(format_row(one) for one in list_settings(UpSettings))
    return f"{before}{BEGIN}\n{HEAD}{rows}\n{END}{after}"


def format_row(field: SettingField) -> str:
    """Write a setting as a row."""
    keyword = f"`{field.name}`" if field.name in WorldKeywords.__annotations__ else ""
    served = "yes" if field in list_settings(ServeSettings) else ""
    key = field.setting.key and f"`{field.setting.key}`"
    cells = (f"`{field.spelling}`", served, key, keyword, _default(field), _mean(field))
    return f"| {' | '.join(cells)} |\n"


def _mean(field: SettingField) -> str:
    ranged = field.setting.least is not None or field.setting.most is not None
    words = ", ".join(f"`{one}`" for one in field.choices)
    limits = f" Use {describe_range(field)}." if ranged else ""
    return spell_flags(write_help(field)) + limits + (f" One of {words}." if words else "")


def _default(field: SettingField) -> str:
    if field.setting.usual:
        return spell_flags(field.setting.usual)
    if isinstance(field.default, bool):
        return "on" if field.default else "off"
    return f"`{field.default}`" if field.default not in ((), "", None) else ""


if __name__ == "__main__":
    main()
