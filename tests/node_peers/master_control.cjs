// A master control of VDA 5050 2.0 on vda-5050-lib.
// Usage: node master_control.cjs URL INTERFACE. Each line of standard input is a command as JSON:
// {"do": "order" | "instant", "robot": ..., ...}; each line of standard output is an event as JSON.
"use strict";

const readline = require("node:readline");
const { MasterController } = require("vda-5050-lib");

const [brokerUrl, interfaceName] = process.argv.slice(2);
const master = new MasterController(
  { interfaceName, transport: { brokerUrl }, vdaVersion: "2.0.0" },
  { topicFormat: "%interfaceName%/%majorVersion%/%manufacturer%/%serialNumber%/%topic%" },
);

function print(event, fields = {}) {
  process.stdout.write(JSON.stringify({ event, ...fields }) + "\n");
}

async function assign({ robot, order }) {
  const handler = {
    onOrderProcessed: (error, isCanceled, isActive, { order }) =>
      print("processed", { robot, order: order.orderId, error: error || null, isCanceled, isActive }),
    onNodeTraversed: (node) => print("traversed", { robot, node: node.nodeId }),
    onActionStateChanged: (state) =>
      print("action", { robot, action: state.actionId, status: state.actionStatus }),
  };
  await master.assignOrder({ manufacturer: "zensim", serialNumber: robot }, order, handler);
}

async function initiate({ robot, actions }) {
  const handler = {
    onActionStateChanged: (state) =>
      print("action", { robot, action: state.actionId, status: state.actionStatus }),
    onActionError: (error) => print("action_error", { robot, type: error.errorType }),
  };
  await master.initiateInstantActions({ manufacturer: "zensim", serialNumber: robot }, { instantActions: actions }, handler);
}

async function main() {
  await master.start();
  master.trackAgvs((agv, state) => print("tracked", { robot: agv.serialNumber, state }));
  readline.createInterface({ input: process.stdin }).on("line", (line) => {
    const command = JSON.parse(line);
    const work = command.do === "order" ? assign(command) : initiate(command);
    work.catch((error) => print("refused", { text: String(error) }));
  });
  print("ready");
}

main().catch((error) => {
  process.stderr.write(`${error}\n`);
  process.exit(1);
});
