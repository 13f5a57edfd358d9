// MessagePack (msgpack.org), as the mapper speaks it: nil, booleans, numbers, texts, bytes, arrays, maps by texts.

const utf8 = new TextDecoder("utf-8", {fatal: true}), toUtf8 = new TextEncoder();

class Reader {
  constructor(bytes) {
    this.bytes = bytes;
    this.data = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    this.at = 0;
  }

  // The next `length` bytes, as a view of the message.
  take(length) {
    if (this.at + length > this.bytes.length) throw new RangeError("the message ends too early");
    this.at += length;
    return this.bytes.subarray(this.at - length, this.at);
  }

  number(kind, length) {
    this.take(length);
    const value = this.data[`get${kind}`](this.at - length);
    // Numbers up to 2^53 are exact; others remain BigInts.
    return typeof value === "bigint" && BigInt.asIntN(54, value) === value ? Number(value) : value;
  }

  text(length) { return utf8.decode(this.take(length)); }
  array(length) { return Array.from({length}, () => this.value()); }

  map(length) {
    const found = {};
    for (let k = 0; k < length; k++) {
      const key = this.value();
      if (typeof key !== "string") throw new TypeError(`a key that is no text: ${key}`);
      // Not by assignment: "__proto__" is a name like any other.
      Object.defineProperty(found, key, {value: this.value(), enumerable: true, writable: true, configurable: true});
    }
    return found;
  }

  value() {
    const type = this.number("Uint8", 1);
    if (type < 0x80) return type;
    if (type < 0x90) return this.map(type & 0x0f);
    if (type < 0xa0) return this.array(type & 0x0f);
    if (type < 0xc0) return this.text(type & 0x1f);
    if (type >= 0xe0) return type - 256;
    const read = TYPES[type];
    if (!read) throw new TypeError(`a type that nobody sends: 0x${type.toString(16)}`);
    return read(this);
  }
}

const size = (reader, length) => reader.number(`Uint${8 * length}`, length);
const TYPES = {
  0xc0: () => null, 0xc2: () => false, 0xc3: () => true,
  0xc4: (r) => r.take(size(r, 1)), 0xc5: (r) => r.take(size(r, 2)), 0xc6: (r) => r.take(size(r, 4)),
  0xca: (r) => r.number("Float32", 4), 0xcb: (r) => r.number("Float64", 8),
  0xcc: (r) => r.number("Uint8", 1), 0xcd: (r) => r.number("Uint16", 2),
  0xce: (r) => r.number("Uint32", 4), 0xcf: (r) => r.number("BigUint64", 8),
  0xd0: (r) => r.number("Int8", 1), 0xd1: (r) => r.number("Int16", 2),
  0xd2: (r) => r.number("Int32", 4), 0xd3: (r) => r.number("BigInt64", 8),
  0xd9: (r) => r.text(size(r, 1)), 0xda: (r) => r.text(size(r, 2)), 0xdb: (r) => r.text(size(r, 4)),
  0xdc: (r) => r.array(size(r, 2)), 0xdd: (r) => r.array(size(r, 4)),
  0xde: (r) => r.map(size(r, 2)), 0xdf: (r) => r.map(size(r, 4)),
};

// The value of a whole message; bytes are views of it. It throws where the message is none.
export function unpack(message) {
  const reader = new Reader(new Uint8Array(message));
  const value = reader.value();
  if (reader.at !== reader.bytes.length) throw new RangeError("bytes after the end of the message");
  return value;
}

// A message of nil, booleans, numbers, short texts, arrays and objects: what the page says.
export function pack(value) {
  const bytes = [];
  write(value, bytes);
  return Uint8Array.from(bytes);
}

function head(type, length, bytes) {
  if (length > 0xffff) throw new RangeError(`too long to be said: ${length}`);
  bytes.push(type, length >> 8, length & 0xff);
}

function float(value, bytes) {
  const data = new DataView(new ArrayBuffer(8));
  data.setFloat64(0, value);
  bytes.push(0xcb, ...new Uint8Array(data.buffer));
}

function integer(value, bytes) {
  const data = new DataView(new ArrayBuffer(8));
  data.setBigInt64(0, BigInt(value));
  if (value >= 0 && value < 0x80) bytes.push(value);
  else bytes.push(0xd3, ...new Uint8Array(data.buffer));
}

function write(value, bytes) {
  if (value === null) bytes.push(0xc0);
  else if (typeof value === "boolean") bytes.push(value ? 0xc3 : 0xc2);
  else if (Number.isSafeInteger(value)) integer(value, bytes);
  else if (typeof value === "number") float(value, bytes);
  else if (typeof value === "string") {
    const text = toUtf8.encode(value);
    head(0xda, text.length, bytes);
    bytes.push(...text);
  } else if (Array.isArray(value)) {
    head(0xdc, value.length, bytes);
    for (const one of value) write(one, bytes);
  } else if (typeof value === "object") {
    head(0xde, Object.keys(value).length, bytes);
    for (const [key, one] of Object.entries(value)) { write(key, bytes); write(one, bytes); }
  } else throw new TypeError(`cannot be said: ${typeof value}`);
}
