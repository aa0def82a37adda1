import struct
import tracemalloc

from zensim.recording.chunk_index_log import ChunkIndexLog
from zensim.recording.mcap_records import Chunk

CHUNK_INDEX_HEAD_BYTES = 1 + 8


def a_chunk(number: int) -> Chunk:
    """Make a chunk without its content's bytes."""
    size = 1 << 20
    return Chunk(number, number + 5, size, 0, "zstd" if number % 2 else "", bytes(size // 100))


def test_records_name_positions_after_the_chunk() -> None:
    log = ChunkIndexLog()
    log.append(a_chunk(1), at=100, length=50, counts={7: 2, 3: 1})

    (record,) = log.read()

    assert len(record) == log.size
    body = record[CHUNK_INDEX_HEAD_BYTES:]
    assert struct.unpack_from("<QQQQI", body) == (1, 6, 100, 50, 2 * 10)
    # Message indexes of two messages and of one follow the record of the chunk.
    assert struct.unpack_from("<HQHQ", body, 36) == (7, 150, 3, 150 + 15 + 32)
    assert struct.unpack_from("<Q", body, 56) == (15 + 32 + 15 + 16,)


def test_all_records_are_read_in_turn() -> None:
    log = ChunkIndexLog()
    for number in range(2000):
        counts = {1 + one: 5 + (number + one) % 3 for one in range(number % 120)}
        log.append(a_chunk(number), at=number << 20, length=1000, counts=counts)

    records = list(log.read())

    starts = [struct.unpack_from("<Q", one, CHUNK_INDEX_HEAD_BYTES)[0] for one in records]
    assert starts == list(range(2000))
    assert sum(map(len, records)) == log.size


def test_memory_is_a_tenth_of_the_records() -> None:
    log, counts = ChunkIndexLog(), dict.fromkeys(range(1, 101), 14)
    chunk = a_chunk(1)
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()

    for number in range(5000):
        log.append(chunk, at=number * 84_123, length=82_000 + number % 97, counts=counts)

    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert log.size > 5_000_000
    assert grown < log.size / 10
