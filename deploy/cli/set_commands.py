"""`zensim set`: change pose, velocity, category, tags or description of an entity."""

import msgspec

from zensim.deploy.cli.command_session import EntityName, open_client, print_json
from zensim.deploy.cli.info_options import NewInfoOptions, change_info, format_category, print_info
from zensim.deploy.cli.state_options import NewStateOptions, change_state, format_state
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.options.command_options import ClientOptions, JsonOption
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines

app = make_app()


@app.command(
    "set",
    epilog="""Examples:
  zensim set r1 -x 1 -Y 0.5
  zensim set r1 --linear 0.2 0 0 --frame r2
  zensim set r1 --category robot --tag red --tag fast""",
)
def set_entity(
    name: EntityName,
    *,
    state: NewStateOptions,
    info: NewInfoOptions,
    as_json: JsonOption = False,
    server: ClientOptions,
) -> None:
    """Set pose, velocity, category, tags or description of an entity, and print what is set."""
    has_state = state.has_pose or state.has_twist
    with exit_on_failure("set"):
        info.check()
        if not (has_state or info.is_given):
            raise ValueError(
                "nothing to set; give -x -y -z -R -P -Y, --linear, --angular, --category, --tag, "
                "--no-tags or --description"
            )
    with open_client("set", server) as client:
        if has_state:
            change_state(client, name, state)
        new_info = change_info(client, name, info) if info.is_given else None
        new_state = client.entity_state(name, state.frame) if has_state else None
    if as_json:
        facts = msgspec.to_builtins(new_state) if new_state is not None else {}
        if new_info is not None:
            facts |= msgspec.to_builtins(new_info)
            facts["category"] = format_category(new_info.category)
        print_json({"entity": name, **facts})
        return
    if new_state is not None:
        print_lines("\n".join(format_state(name, new_state)))
    if new_info is not None:
        print_info(name, new_info)
