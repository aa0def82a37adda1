// Reads a recording with @mcap/core and decodes its messages with @foxglove/rosmsg2-serialization.
// Usage: node read_mcap.cjs FILE [stream]; prints one JSON object: topics with counts, and a sample.
"use strict";

const { open, readFile } = require("node:fs/promises");
const { McapIndexedReader, McapStreamReader } = require("@mcap/core");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");
const { decompress } = require("fzstd");

const DECOMPRESS = { zstd: (bytes) => decompress(bytes) };

class Found {
  constructor() {
    this.profile = "";
    this.topics = {};
    this.messages = 0;
    this.attachments = [];
    this.readers = new Map();
  }

  readerOf(channel, schema) {
    if (!this.readers.has(channel.id)) {
      const text = new TextDecoder().decode(schema.data);
      this.readers.set(channel.id, new MessageReader(parse(text, { ros2: true })));
    }
    return this.readers.get(channel.id);
  }

  add(channel, schema, message) {
    const value = this.readerOf(channel, schema).readMessage(message.data);
    const topic = (this.topics[channel.topic] ??= {
      schema: schema.name,
      count: 0,
      first: String(message.logTime),
      example: value,
    });
    topic.count += 1;
    topic.last = String(message.logTime);
    this.messages += 1;
  }

  print() {
    const { profile, topics, messages, attachments } = this;
    const plain = (_, value) => {
      if (typeof value === "bigint") return String(value);
      return ArrayBuffer.isView(value) ? Array.from(value, Number) : value;
    };
    console.log(JSON.stringify({ profile, topics, messages, attachments }, plain));
  }
}

async function readIndexed(path, found) {
  const handle = await open(path);
  try {
    const { size } = await handle.stat();
    const readable = {
      size: async () => BigInt(size),
      read: async (offset, length) => {
        const bytes = new Uint8Array(Number(length));
        await handle.read(bytes, 0, bytes.length, Number(offset));
        return bytes;
      },
    };
    const reader = await McapIndexedReader.Initialize({
      readable,
      decompressHandlers: DECOMPRESS,
    });
    found.profile = reader.header.profile;
    for await (const one of reader.readAttachments()) found.attachments.push(one.name);
    for await (const message of reader.readMessages()) {
      const channel = reader.channelsById.get(message.channelId);
      found.add(channel, reader.schemasById.get(channel.schemaId), message);
    }
  } finally {
    await handle.close();
  }
}

async function readStreamed(path, found) {
  const reader = new McapStreamReader({ decompressHandlers: DECOMPRESS, validateCrcs: true });
  reader.append(await readFile(path));
  const channels = new Map();
  const schemas = new Map();
  for (let record; (record = reader.nextRecord()); ) {
    if (record.type === "Header") found.profile = record.profile;
    else if (record.type === "Schema") schemas.set(record.id, record);
    else if (record.type === "Channel") channels.set(record.id, record);
    else if (record.type === "Attachment") found.attachments.push(record.name);
    else if (record.type === "Message") {
      const channel = channels.get(record.channelId);
      found.add(channel, schemas.get(channel.schemaId), record);
    }
  }
}

async function main([path, mode]) {
  const found = new Found();
  await (mode === "stream" ? readStreamed : readIndexed)(path, found);
  found.print();
}

main(process.argv.slice(2)).catch((error) => {
  console.error(error.stack ?? String(error));
  process.exit(1);
});
