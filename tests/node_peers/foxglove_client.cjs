// A client of the Foxglove WebSocket protocol on @foxglove/ws-protocol.
// Usage: node foxglove_client.cjs URL SUBPROTOCOL [ORIGIN]. Each line of standard input is a command
// as JSON: {"do": ...}; each line of standard output is an event as JSON: {"event": ...}.
"use strict";

const readline = require("node:readline");
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader, MessageWriter } = require("@foxglove/rosmsg2-serialization");
const WebSocket = require("ws");

const [url, subprotocol, origin] = process.argv.slice(2);
const socket = new WebSocket(url, [subprotocol], origin ? { origin } : {});
const client = new FoxgloveClient({ ws: socket });
const channels = new Map();
const services = new Map();
const subscriptions = new Map();
const readers = new Map();

function print(event, fields = {}) {
  const plain = (_, value) => {
    if (typeof value === "bigint") return String(value);
    return ArrayBuffer.isView(value) ? Array.from(value, Number) : value;
  };
  process.stdout.write(JSON.stringify({ event, ...fields }, plain) + "\n");
}

function definitionOf({ schema }) {
  return parse(schema, { ros2: true });
}

function parseJson(data) {
  return JSON.parse(new TextDecoder().decode(data));
}

function readMessage(channel, data) {
  if (!readers.has(channel.id)) readers.set(channel.id, new MessageReader(definitionOf(channel)));
  return readers.get(channel.id).readMessage(data);
}

function find(map, field, wanted) {
  for (const one of map.values()) if (one[field] === wanted) return one;
  throw new Error(`nothing has ${field} ${wanted}`);
}

client.on("open", () => print("open", { subprotocol: socket.protocol }));
client.on("close", (event) => {
  print("close", { code: event.code });
  process.exit(0);
});
client.on("error", (error) => print("error", { message: String(error.message ?? error) }));
client.on("serverInfo", (info) => print("serverInfo", info));
client.on("status", (status) => print("status", { level: status.level, message: status.message }));
client.on("advertise", (added) => {
  for (const one of added) channels.set(one.id, one);
  print("advertise", { topics: added.map((one) => one.topic) });
});
client.on("unadvertise", (ids) => {
  const topics = ids.map((id) => channels.get(id)?.topic);
  for (const id of ids) channels.delete(id);
  print("unadvertise", { topics });
});
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const channel = subscriptions.get(subscriptionId);
  if (!channel) return; // it came before the unsubscription
  const value = channel.encoding === "json" ? parseJson(data) : readMessage(channel, data);
  print("message", { topic: channel.topic, schemaName: channel.schemaName, timestamp, value });
});
client.on("time", ({ timestamp }) => print("time", { timestamp }));
client.on("advertiseServices", (added) => {
  for (const one of added) services.set(one.id, one);
  print("advertiseServices", { names: added.map((one) => one.name) });
});
client.on("serviceCallResponse", ({ serviceId, callId, encoding, data }) => {
  const service = services.get(serviceId);
  const value =
    encoding === "json"
      ? parseJson(data)
      : new MessageReader(definitionOf(service.response)).readMessage(data);
  print("serviceCallResponse", { callId, value });
});
client.on("serviceCallFailure", ({ callId, message }) =>
  print("serviceCallFailure", { callId, message }),
);
client.on("parameterValues", ({ parameters, id }) => print("parameterValues", { parameters, id }));
client.on("connectionGraphUpdate", (update) => print("connectionGraphUpdate", update));
client.on("fetchAssetResponse", (response) => {
  const { requestId, status, data, error } = response;
  const content = data
    ? Buffer.from(data.buffer, data.byteOffset, data.byteLength).toString("base64")
    : "";
  print("fetchAssetResponse", { requestId, status, content, error });
});

const published = new Map();
const actions = {
  subscribe: ({ topic }) => {
    const channel = find(channels, "topic", topic);
    subscriptions.set(client.subscribe(channel.id), channel);
  },
  unsubscribe: ({ topic }) => {
    for (const [id, channel] of subscriptions) {
      if (channel.topic !== topic) continue;
      subscriptions.delete(id);
      client.unsubscribe(id);
    }
  },
  advertise: ({ topic, encoding, schemaName, schema }) => {
    const channel = { topic, encoding, schemaName, schema, schemaEncoding: "ros2msg" };
    published.set(topic, { ...channel, id: client.advertise(channel) });
  },
  publish: ({ topic, value }) => {
    const channel = published.get(topic);
    const bytes =
      channel.encoding === "json"
        ? new TextEncoder().encode(JSON.stringify(value))
        : new MessageWriter(definitionOf(channel)).writeMessage(value);
    client.sendMessage(channel.id, bytes);
  },
  call: ({ name, callId, encoding, value }) => {
    const service = find(services, "name", name);
    const bytes =
      encoding === "json"
        ? new TextEncoder().encode(JSON.stringify(value))
        : new MessageWriter(definitionOf(service.request)).writeMessage(value);
    client.sendServiceCallRequest({ serviceId: service.id, callId, encoding, data: bytes });
  },
  callUnknown: ({ serviceId, callId }) =>
    client.sendServiceCallRequest({
      serviceId,
      callId,
      encoding: "cdr",
      data: new Uint8Array([0, 1, 0, 0]),
    }),
  getParameters: ({ names, id }) => client.getParameters(names, id),
  setParameters: ({ parameters, id }) => client.setParameters(parameters, id),
  subscribeParameters: ({ names }) => client.subscribeParameterUpdates(names),
  subscribeGraph: () => client.subscribeConnectionGraph(),
  fetchAsset: ({ uri, requestId }) => client.fetchAsset(uri, requestId),
  close: () => client.close(),
};

readline.createInterface({ input: process.stdin }).on("line", (line) => {
  const command = JSON.parse(line);
  try {
    actions[command.do](command);
  } catch (error) {
    print("error", { message: error.message });
  }
});
