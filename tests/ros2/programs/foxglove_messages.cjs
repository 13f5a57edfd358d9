// Messages as Foxglove reads them: a line of JSON in, a line of JSON out.
//
//     {"type": "nav_msgs/msg/OccupancyGrid", "definition": "...", "cdr": "..."}   ->   {"values": {...}}

const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");
const lines = require("node:readline").createInterface({ input: process.stdin });

function plain(_, value) {
  return ArrayBuffer.isView(value) ? Array.from(value) : value;
}

lines.on("line", (line) => {
  const asked = JSON.parse(line);
  const reader = new MessageReader(parse(asked.definition, { ros2: true }));
  const values = reader.readMessage(Buffer.from(asked.cdr, "hex"));
  console.log(JSON.stringify({ values }, plain));
});
