"""The topics of a network for commands, and a note on one that is not there."""

from typing import Final

from zensim.proto import keys
from zensim.proto.bus.bus_errors import BusError
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.telemetry_messages import GetModelsResponse
from zensim.proto.near_names import list_near
from zensim.proto.topic_discovery import TopicFacts, list_topics
from zensim.proto.verbosity import print_note
from zensim.spawner.client.sim_client import SimClient

ABSENCE_TIMEOUT_S: Final = 0.5
"""Time without a message after which it is looked up whether there is such a topic."""
MOST_NEAR: Final = 3


def find_topics(client: SimClient) -> list[TopicFacts]:
    """Find all topics; without a server, those that programs announce."""
    models: GetModelsResponse | None = None
    try:
        models = client.models()
    except (BusError, ServiceError, TimeoutError) as error:
        print_note("topic", f"the topics of the server are left out: {error}")
    return list_topics(client.bus, client.world, models)


def advise_topic(key: str, topics: list[TopicFacts]) -> str:
    """Advise what to type instead of the key of a topic that is not there."""
    near = list_near(key, (one.key for one in topics), most=MOST_NEAR)
    return f"similar ones are {', '.join(near)}" if near else "'zensim topic list' lists all"


def note_absence(client: SimClient, command: str, key: str) -> None:
    """Print a note if no topic has the key that a command waits for."""
    topics = find_topics(client)
    if not any(keys.intersect(key, one.key) for one in topics):
        print_note(command, f"there is no topic '{key}' yet; {advise_topic(key, topics)}")
