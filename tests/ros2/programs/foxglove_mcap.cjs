// MCAP files as Foxglove reads them: a line of JSON in, a line of JSON out.
//
//     {"file": "drive.mcap"}   ->   {"profile": "ros2", "messages": [["/tf", "tf2_msgs/msg/TFMessage", {...}], ...]}

const { McapIndexedReader } = require("@mcap/core");
const { FileHandleReadable } = require("@mcap/nodejs");
const { loadDecompressHandlers } = require("@mcap/support");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");
const { open } = require("node:fs/promises");
const lines = require("node:readline").createInterface({ input: process.stdin });

// JSON has neither numbers of 64 bits nor those that are not finite.
function plain(_, value) {
  if (typeof value === "bigint") return value.toString();
  if (typeof value === "number" && !Number.isFinite(value)) return String(value);
  return ArrayBuffer.isView(value) ? Array.from(value, (each) => plain("", each)) : value;
}

async function read(path) {
  const file = await open(path, "r");
  try {
    const readable = new FileHandleReadable(file);
    const decompressHandlers = await loadDecompressHandlers();
    const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
    const readers = new Map();
    for (const channel of reader.channelsById.values()) {
      const schema = reader.schemasById.get(channel.schemaId);
      const definition = parse(new TextDecoder().decode(schema.data), { ros2: true });
      readers.set(channel.id, [channel.topic, schema.name, new MessageReader(definition)]);
    }
    const messages = [];
    for await (const message of reader.readMessages()) {
      const [topic, type, decoder] = readers.get(message.channelId);
      messages.push([topic, type, decoder.readMessage(message.data)]);
    }
    return { profile: reader.header.profile, messages };
  } finally {
    await file.close();
  }
}

lines.on("line", async (line) => {
  console.log(JSON.stringify(await read(JSON.parse(line).file), plain));
});
