// What a file of points holds: clouds, flat and in space, or an Error that says in words what is wrong with it.
// Idea: a reader gets the bytes and returns { clouds: [numbers], columns, python }: numbers point after point, and the expression that
// reads the same in Python. What a header declares is compared with the bytes that are there before memory is taken.
function fileReaders() {
  const MOST_BYTES = 2 ** 28, MOST_POINTS = 5e6, MOST_FRAMES = 2000, MOST_COLUMNS = 16, MOST_NUMBERS = 2 ** 25, LONGEST_LINE = 10000;
  const CAMERAS = ["240,320", "424,512", "480,640", "480,848", "576,640", "720,1280", "1080,1920"]; // images (h, w, 3), not films
  const { middleOf, cutAway, largestPlane } = cloudCuts();
  const fail = (text) => {
    throw new Error(text);
  };
  const latin = (bytes) => new TextDecoder("latin1").decode(bytes);
  const many = (count, what) => `${count.toLocaleString("en")} ${what}${count === 1 ? "" : "s"}`;
  const sum = (list) => list.reduce((total, value) => total + value, 0);
  const quoted = (name) => JSON.stringify(name);
  function checkCount(count) {
    if (!(Number.isInteger(count) && count >= 0)) fail("damaged: its header declares no number of points");
    if (count > MOST_POINTS) fail(`${many(count, "point")}; this page reads up to ${MOST_POINTS.toLocaleString("en")}: thin the cloud out first`);
  }
  function checkRoom(needed, there, what) {
    if (needed > there) fail(`cut off: ${what} take ${many(needed, "byte")}, and there are ${there.toLocaleString("en")}`);
  }

  // ---- numbers in bytes ------------------------------------------------------------------------------------------
  const SIZES = { i1: 1, u1: 1, i2: 2, u2: 2, f2: 2, i4: 4, u4: 4, f4: 4, i8: 8, u8: 8, f8: 8 };
  function half(bits) { // a number of 16 bits
    const exponent = (bits >> 10) & 31, share = bits & 1023, sign = bits >> 15 ? -1 : 1;
    if (exponent === 31) return share ? NaN : sign * Infinity;
    return sign * (exponent ? 2 ** (exponent - 15) * (1 + share / 1024) : 2 ** -24 * share);
  }
  function taker(bytes, type, little) { // the number at a place
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    return {
      i1: (at) => view.getInt8(at), u1: (at) => view.getUint8(at), i2: (at) => view.getInt16(at, little), u2: (at) => view.getUint16(at, little),
      i4: (at) => view.getInt32(at, little), u4: (at) => view.getUint32(at, little), f2: (at) => half(view.getUint16(at, little)),
      f4: (at) => view.getFloat32(at, little), f8: (at) => view.getFloat64(at, little),
      i8: (at) => Number(view.getBigInt64(at, little)), u8: (at) => Number(view.getBigUint64(at, little)),
    }[type];
  }
  function strided(count, takes, place) { // one number of each taker for each of `count` rows; place(row, column) is its byte
    const out = new Float64Array(count * takes.length);
    takes.forEach((take, c) => {
      for (let i = 0; i < count; i++) out[i * takes.length + c] = take(place(i, c));
    });
    return out;
  }
  function placeOf(names) { // where x, y and z are among the columns
    const at = ["x", "y", "z"].map((axis) => names.indexOf(axis));
    if (at.includes(-1)) fail(`its points have no x, y and z, but ${names.join(", ") || "nothing"}`);
    return at;
  }

  // ---- columns of a table ------------------------------------------------------------------------------------------
  // Which columns are a place: those that the reader chose, those named x, y and z, or the first three after one that counts the rows.
  function columnsOf(start, wide, names, asked) { // start: the numbers of the first rows
    const rows = Math.floor(start.length / wide), first = start[0] === 1 ? 1 : 0;
    const counts = wide > 2 && rows > 7 && Array.from({ length: rows }, (_, i) => start[i * wide]).every((value, i) => value === first + i);
    const named = ["x", "y", "z"].every((axis) => names.includes(axis)), fits = asked?.every((c) => c < wide);
    let kept = (counts ? [1, 2, 3] : [0, 1, 2]).filter((c) => c < wide);
    if (named) kept = placeOf(names);
    if (fits) kept = asked;
    const label = (c) => `${c + 1}${names[c] ? ` (${names[c].slice(0, 20)})` : ""}: ${[...start.filter((_, i) => i % wide === c).slice(0, 3)].map((v) => +v.toPrecision(4)).join(", ")}`;
    const table = wide > 3 || counts || fits ? { kept, counts, labels: Array.from({ length: wide }, (_, c) => label(c)) } : null;
    return { kept, named, table, first: kept.every((column, k) => column === k) };
  }
  const FIRST_ROWS = 200;

  // ---- .ply --------------------------------------------------------------------------------------------------------
  const PLY_TYPES = { char: "i1", uchar: "u1", short: "i2", ushort: "u2", int: "i4", uint: "u4", float: "f4", double: "f8",
    int8: "i1", uint8: "u1", int16: "i2", uint16: "u2", int32: "i4", uint32: "u4", float32: "f4", float64: "f8" };
  function plyHeader(bytes) {
    const text = latin(bytes.subarray(0, 2 ** 16)), end = /^end_header[ \t]*(\r\n|\n|\r)/m.exec(text), elements = [];
    if (!/^ply\s/.test(text)) fail("not a PLY file: it does not begin with the word ply");
    if (!end) fail("its header has no line end_header");
    let format;
    for (const line of text.slice(0, end.index).split(/[\r\n]+/)) {
      const [word, ...rest] = line.trim().split(/\s+/);
      if (word === "format") format = rest[0];
      if (word === "element") elements.push({ name: rest[0], count: +rest[1], properties: [] });
      if (word !== "property") continue;
      const list = rest[0] === "list", types = rest.slice(list ? 1 : 0, -1).map((name) => PLY_TYPES[name]);
      const known = elements.length > 0 && types.length === (list ? 2 : 1) && !types.includes(undefined);
      if (!known) fail(`a line of its header is not understood: ${line.slice(0, 60)}`);
      elements.at(-1).properties.push({ name: rest.at(-1), types });
    }
    if (!["ascii", "binary_little_endian", "binary_big_endian"].includes(format)) fail(`its format is ${format}, which is none of PLY`);
    return { format, elements, start: end.index + end[0].length };
  }
  function readPly(bytes) {
    const { format, elements, start } = plyHeader(bytes), body = bytes.subarray(start), little = format === "binary_little_endian";
    const vertex = elements.find((element) => element.name === "vertex") ?? fail("it has no element vertex");
    checkCount(vertex.count);
    const at = placeOf(vertex.properties.map((property) => property.name)), views = {};
    const text = format === "ascii" ? latin(body) : null, word = /\S+/g;
    let [here, ended] = [0, false];
    const take = (type) => { // the next number
      const found = text === null ? (here += SIZES[type]) <= body.length : word.exec(text);
      ended ||= !found;
      if (ended) return NaN;
      return text === null ? (views[type] ??= taker(body, type, little))(here - SIZES[type]) : Number(found[0]);
    };
    const row = ({ name, count, properties }, put = () => {}) => properties.forEach(({ types }, c) => {
      for (let left = types.length > 1 ? take(types[0]) : 1; left > 0 && !ended; left--) put(c, take(types.at(-1)));
      if (ended) fail(`cut off: it ends within the ${count.toLocaleString("en")} rows of its element ${name}`);
    });
    for (const element of elements.slice(0, elements.indexOf(vertex))) {
      for (let i = 0; i < element.count && element.properties.length; i++) row(element);
    }

    // Rows of one width are read column by column, others number by number.
    const sizes = vertex.properties.map(({ types }) => (types.length > 1 ? NaN : SIZES[types[0]])), wide = sum(sizes);
    if (text === null && wide) {
      checkRoom(vertex.count * wide, body.length - here, `${many(vertex.count, "row")} of ${wide} bytes`);
      const offsets = at.map((c) => here + sum(sizes.slice(0, c))), takes = at.map((c) => taker(body, vertex.properties[c].types[0], little));
      return cloudOf(strided(vertex.count, takes, (i, c) => offsets[c] + i * wide), "ply");
    }
    const out = new Float64Array(3 * Math.min(vertex.count, body.length));
    for (let i = 0; i < vertex.count; i++) row(vertex, (c, value) => at.includes(c) && (out[3 * i + at.indexOf(c)] = value));
    return cloudOf(out, "ply");
  }
  const cloudOf = (numbers, python) => ({ clouds: [numbers], columns: 3, python });

  // ---- .pcd --------------------------------------------------------------------------------------------------------
  function unpackLzf(packed, length) { // Lehmann's LZF: runs of bytes as they are, and repetitions of what was unpacked before
    const out = new Uint8Array(length);
    let from = 0, to = 0;
    while (from < packed.length) {
      const control = packed[from++];
      if (control < 32) {
        if (from + control + 1 > packed.length || to + control + 1 > length) fail("damaged: its packed points cannot be unpacked");
        out.set(packed.subarray(from, from + control + 1), to);
        from += control + 1;
        to += control + 1;
        continue;
      }
      let size = (control >> 5) + 2;
      if (size === 9) size += packed[from++];
      let back = to - ((control & 31) << 8) - packed[from++] - 1;
      if (!(back >= 0 && to + size <= length)) fail("damaged: its packed points cannot be unpacked");
      while (size--) out[to++] = out[back++];
    }
    if (to !== length) fail(`damaged: ${many(to, "byte")} where ${length.toLocaleString("en")} are declared`);
    return out;
  }
  function readPcd(bytes) {
    const text = latin(bytes.subarray(0, 2 ** 14)), end = /^DATA[ \t]+(\w+)[^\n]*\n/m.exec(text);
    if (!end) fail("not a PCD file: its header has no line DATA");
    const line = (word) => new RegExp(`^${word}[ \\t]+([^\\r\\n]*)`, "m").exec(text.slice(0, end.index))?.[1].trim().split(/\s+/);
    const names = line("FIELDS") ?? fail("its header has no line FIELDS"), counts = (line("COUNT") ?? names.map(() => 1)).map(Number);
    const types = names.map((_, c) => (line("TYPE")?.[c] ?? "?").toLowerCase() + (line("SIZE")?.[c] ?? "?"));
    const points = Number(line("POINTS")?.[0] ?? line("WIDTH")?.[0] * (line("HEIGHT")?.[0] ?? 1));
    checkCount(points);
    const at = placeOf(names.map((name) => name.toLowerCase())), kind = end[1].toLowerCase();
    const fits = types.every((type) => type in SIZES) && counts.every((count) => Number.isInteger(count) && count >= 0 && count < 4096);
    if (!fits || counts.length !== names.length) fail("its lines SIZE, TYPE and COUNT do not fit its FIELDS");
    let body = bytes.subarray(end.index + end[0].length);
    const widths = names.map((_, c) => SIZES[types[c]] * counts[c]), wide = sum(widths), before = (list, c) => sum(list.slice(0, c));
    if (kind === "ascii") {
      const { numbers, rows } = table(latin(body), (columns) => {
        if (columns !== sum(counts)) fail(`its first row has ${many(columns, "number")}, and its header declares ${sum(counts)}`);
        return at.map((c) => before(counts, c));
      });
      if (rows !== points) fail(`${many(points, "point")} in its header, and ${rows.toLocaleString("en")} in the file`);
      return cloudOf(numbers, "pcd");
    }
    if (kind !== "binary" && kind !== "binary_compressed") fail(`its DATA is ${kind}, which is none of PCD`);
    if (kind === "binary_compressed") {
      checkRoom(8, body.length, "the sizes of packed points");
      const size = taker(body, "u4", true), [packed, whole] = [size(0), size(4)];
      checkRoom(packed, body.length - 8, "its packed points");
      const honest = whole === points * wide && whole <= 100 * packed + 1000;
      if (!honest) fail(`damaged: ${many(points, "point")} of ${wide} bytes, but ${many(whole, "byte")} packed into ${packed}`);
      body = unpackLzf(body.subarray(8, 8 + packed), whole);
    }
    checkRoom(points * wide, body.length, `${many(points, "point")} of ${wide} bytes`);
    const takes = at.map((c) => taker(body, types[c], true)), starts = at.map((c) => before(widths, c)), steps = at.map((c) => widths[c]);
    if (kind === "binary") return cloudOf(strided(points, takes, (i, c) => i * wide + starts[c]), "pcd");
    return cloudOf(strided(points, takes, (i, c) => points * starts[c] + i * steps[c]), "pcd"); // field after field
  }

  // ---- .npy and .npz -----------------------------------------------------------------------------------------------
  function readArray(bytes) { // of a .npy: its shape and its numbers, the last index first to change
    if (bytes[0] !== 0x93 || latin(bytes.subarray(1, 6)) !== "NUMPY") fail("not a file of NumPy: its first bytes are other ones");
    checkRoom(12, bytes.length, "its first lines");
    const long = bytes[6] > 1, room = long ? taker(bytes, "u4", true)(8) : taker(bytes, "u2", true)(8), start = (long ? 12 : 10) + room;
    checkRoom(start, bytes.length, "its header");
    const header = latin(bytes.subarray(long ? 12 : 10, start)), shape = /'shape':\s*\(([^)]*)\)/.exec(header);
    const type = /'descr':\s*'([<>|=]?)([a-zA-Z]\d*)'/.exec(header), given = /'descr':\s*('[^']*'|\[)/.exec(header)?.[1] ?? "no numbers";
    if (!type || !(type[2] in SIZES)) fail(`it holds ${given.replace("[", "fields with names")}; save plain numbers: np.save(name, points.astype(float))`);
    if (!shape) fail("damaged: its header declares no shape");
    const sizes = shape[1].split(",").filter((word) => word.trim()).map(Number), count = sizes.reduce((product, size) => product * size, 1);
    if (!Number.isSafeInteger(count)) fail(`damaged: its header declares the shape (${shape[1].slice(0, 40)})`);
    if (count > MOST_NUMBERS) fail(`${many(count, "number")}; this page reads up to ${MOST_NUMBERS.toLocaleString("en")}: thin the film out first`);
    checkRoom(count * SIZES[type[2]], bytes.length - start, `numbers of shape (${sizes})`);
    const take = taker(bytes.subarray(start), type[2], type[1] !== ">"), size = SIZES[type[2]], numbers = new Float64Array(count);
    if (!/'fortran_order':\s*True/.test(header)) {
      for (let i = 0; i < count; i++) numbers[i] = take(i * size);
      return { shape: sizes, numbers, type: type[2] };
    }
    for (let i = 0; i < count; i++) { // the first index is the first to change
      let [left, place, step] = [i, 0, count];
      for (const length of sizes) {
        step /= length;
        place += step * (left % length);
        left = Math.floor(left / length);
      }
      numbers[place] = take(i * size);
    }
    return { shape: sizes, numbers, type: type[2] };
  }
  function cloudsOfArray({ shape, numbers }, python, asked) { // (n, 2), (n, 3), (T, n, 3), (T, h, w, 3), or (h, w, 3) of a depth camera
    const columns = shape.at(-1), given = `(${shape.join(", ")})`;
    if (shape.length < 2 || shape.length > 4) fail(`its shape is ${given}; a cloud is (n, 3), a film (T, n, 3)`);
    if (columns < 2 || columns > MOST_COLUMNS) fail(`its shape is ${given}; a row is a point of two or three numbers${shape[0] < 4 ? ": transpose it" : ""}`);
    const film = shape.length > 2 && !CAMERAS.includes(shape.slice(0, 2).join()), frames = film ? shape[0] : 1, size = numbers.length / (frames || 1);
    if (frames > MOST_FRAMES) fail(`${many(frames, "frame")}; this page follows up to ${MOST_FRAMES.toLocaleString("en")}`);
    checkCount(size / columns);
    const flat = shape.length === 4 || (shape.length === 3 && !film) ? ".reshape(" + (film ? `${frames}, -1, ${columns})` : `-1, ${columns})`) : "";
    const { kept, table, first } = columnsOf(numbers.subarray(0, Math.min(size, FIRST_ROWS * columns)), columns, [], asked);
    const all = first && kept.length === columns, picked = all ? numbers : new Float64Array((numbers.length / columns) * kept.length);
    if (!all) for (let i = 0; i < picked.length; i++) picked[i] = numbers[Math.floor(i / kept.length) * columns + kept[i % kept.length]];
    const wide = picked.length / (frames || 1), clouds = Array.from({ length: frames }, (_, t) => picked.subarray(t * wide, (t + 1) * wide));
    const part = first ? `[..., :${kept.length}]` : `[..., [${kept.join(", ")}]]`;
    return { clouds, columns: kept.length, film, table, python: python + flat + (all ? "" : part) };
  }
  const readNpy = (bytes, name, asked) => cloudsOfArray(readArray(bytes), `np.load(${quoted(name)})`, asked);

  const CHECKS = Int32Array.from({ length: 256 }, (_, n) => {
    for (let k = 0; k < 8; k++) n = n & 1 ? (n >>> 1) ^ 0xedb88320 : n >>> 1;
    return n;
  });
  function checksum(bytes) { // CRC-32, as zip files have it
    let check = -1;
    for (let i = 0; i < bytes.length; i++) check = (check >>> 8) ^ CHECKS[(check ^ bytes[i]) & 255];
    return ~check >>> 0;
  }
  async function inflate(packed, length) {
    const chunks = [], stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw")).getReader();
    let got = 0;
    try {
      for (let part = await stream.read(); !part.done; part = await stream.read()) {
        got += part.value.length;
        if (got > length) break;
        chunks.push(part.value);
      }
    } catch {
      fail("damaged: a part of it cannot be unpacked");
    }
    if (got !== length) fail(`damaged: a part of ${many(length, "byte")} unpacks to ${got > length ? "more" : got.toLocaleString("en")}`);
    const out = new Uint8Array(length);
    let at = 0;
    for (const chunk of chunks) {
      out.set(chunk, at);
      at += chunk.length;
    }
    return out;
  }
  function zipEntries(bytes) { // from the list at the end of the file: name, and a function that unpacks it, with how many bytes that makes
    const u2 = taker(bytes, "u2", true), u4 = taker(bytes, "u4", true), entries = new Map();
    let end = bytes.length - 22;
    while (end >= Math.max(0, bytes.length - 65557) && u4(end) !== 0x06054b50) end--;
    if (end < 0 || u4(end) !== 0x06054b50) fail("cut off: it does not end as a zip file does");
    for (let k = 0, at = u4(end + 16); k < u2(end + 10); k++) {
      checkRoom(at + 46, bytes.length, "the entries of its list");
      if (u4(at) !== 0x02014b50) fail("damaged: its list of contents is broken");
      const [method, check, packed, length, start] = [u2(at + 10), u4(at + 16), u4(at + 20), u4(at + 24), u4(at + 42)];
      const name = latin(bytes.subarray(at + 46, at + 46 + u2(at + 28)));
      const unpack = async () => {
        checkRoom(start + 30, bytes.length, "its contents");
        const from = start + 30 + u2(start + 26) + u2(start + 28);
        checkRoom(from + packed, bytes.length, `${name}, packed,`);
        if (method !== 0 && method !== 8) fail(`${name} is packed in a way that is not read here (${method})`);
        const whole = method ? await inflate(bytes.subarray(from, from + packed), length) : bytes.subarray(from, from + packed);
        if (checksum(whole) !== check) fail(`damaged: ${name} is not what was written`);
        return whole;
      };
      entries.set(name, Object.assign(unpack, { bytes: length }));
      at += 46 + u2(at + 28) + u2(at + 30) + u2(at + 32);
    }
    return entries;
  }
  function checkUnpacked(entries, names) { // before anything is unpacked
    const megabytes = Math.round(sum(names.map((name) => entries.get(name)?.bytes ?? 0)) / 2 ** 20);
    if (megabytes > MOST_BYTES / 2 ** 20) fail(`what it holds unpacks to ${megabytes.toLocaleString("en")} MB; this page reads up to ${MOST_BYTES / 2 ** 20}`);
  }
  async function readNpz(bytes, name, asked) {
    const entries = zipEntries(bytes), load = async (key) => {
      checkUnpacked(entries, [key + ".npy"]);
      return readArray(await (entries.get(key + ".npy") ?? (() => fail(`it holds no ${key}`)))());
    };
    if (entries.has("header.json")) return readEpisode(entries, load, name);
    const keys = [...entries.keys()].filter((key) => key.endsWith(".npy")).map((key) => key.slice(0, -4)).filter((key) => key !== "times");
    if (!keys.length) fail(`it holds no array, but ${[...entries.keys()].join(", ").slice(0, 80) || "nothing"}`);
    if (keys.length > 1 && keys.every((key) => /^arr_\d+$/.test(key))) { // unnamed arrays are a cloud each
      const frames = [];
      checkUnpacked(entries, keys.map((key) => key + ".npy"));
      for (let k = 0, count = 0; k < keys.length; k++) {
        const array = await load(`arr_${k}`);
        count += array.numbers.length;
        if (count > MOST_NUMBERS) fail(`its arrays hold more than ${MOST_NUMBERS.toLocaleString("en")} numbers: thin the film out first`);
        frames.push(cloudsOfArray(array, "", asked));
      }
      if (frames.some(({ clouds, columns }) => clouds.length > 1 || columns !== frames[0].columns)) fail("its arrays are no clouds of one kind");
      const part = frames[0].python, python = `[np.load(${quoted(name)})[f"arr_{k}"]${part} for k in range(${keys.length})]`;
      return { ...frames[0], film: true, clouds: frames.map(({ clouds }) => clouds[0]), python };
    }
    const key = keys.includes("points") ? "points" : keys[0];
    if (key !== "points" && keys.length > 1) fail(`it holds ${keys.join(", ").slice(0, 80)}: name the array of points "points"`);
    return cloudsOfArray(await load(key), `np.load(${quoted(name)})[${quoted(key)}]`, asked);
  }
  async function readEpisode(entries, load, name) { // of topokit: steps of 0.1 mm, along time their differences (see topokit/io.py)
    const { kind, frames } = JSON.parse(new TextDecoder().decode(await entries.get("header.json")()));
    if (kind !== "topokit-episode") fail(`it is a file of topokit, but a ${String(kind).replace("topokit-", "file of ")} and no episode`);
    const places = async (key) => { // sums of differences, in whole numbers that wrap around as those of the file do
      const { shape, numbers, type } = await load(key), row = shape[1] * shape[2], wrap = type === "i2" ? (v) => (v << 16) >> 16 : (v) => v | 0;
      if (shape.length !== 3 || shape[0] !== frames) fail(`damaged: ${key} is of shape (${shape.join(", ")}), and its header has ${many(frames, "frame")}`);
      for (let i = row; i < numbers.length; i++) numbers[i] = wrap(numbers[i] + numbers[i - row]);
      return { shape, numbers };
    };
    let { shape, numbers } = await places(entries.has("observed.npy") ? "observed" : "points");
    if (entries.has("observed_ids.npy")) { // of vertices
      const ids = await load("observed_ids"), [wide, seen] = [3 * shape[1], ids.shape[1]];
      if (ids.shape[0] !== frames) fail("damaged: it observes another number of frames than its header has");
      if (ids.numbers.some((id) => id >= shape[1])) fail("damaged: it observes vertices that it does not have");
      const all = numbers;
      numbers = new Float64Array(3 * ids.numbers.length);
      ids.numbers.forEach((id, i) => numbers.set(all.subarray(Math.floor(i / seen) * wide + 3 * id, Math.floor(i / seen) * wide + 3 * id + 3), 3 * i));
      shape = [frames, seen, 3];
    }
    return cloudsOfArray({ shape, numbers: numbers.map((ticks) => Math.fround(ticks / 10000)) }, `load_episode(${quoted(name)}).observed`);
  }

  // ---- text --------------------------------------------------------------------------------------------------------
  const EMPTY = /^$|^[+-]?nan$/i, INFINITE = /^([+-]?)inf(inity)?$/i;
  function valueOf(cell) { // NaN for an empty cell and for the word nan; undefined for other words
    const value = Number(cell);
    if (cell !== "" && !Number.isNaN(value)) return value;
    if (EMPTY.test(cell)) return NaN;
    return INFINITE.test(cell) ? Number(cell.replace(INFINITE, "$1Infinity")) : undefined;
  }
  function table(text, choose) { // numbers in rows, after lines of words; choose(columns, words of the last such line) names the columns to keep
    const start = text.slice(0, 5000), separator = /[;\t]/.exec(start)?.[0] ?? (/[\d.]\s*,/.test(start) ? "," : " ");
    const numbers = [];
    let [rows, columns, skipped, number, names, kept] = [0, 0, 0, 0, null, null];
    for (let at = 0; at <= text.length; ) {
      const stop = text.indexOf("\n", at), end = stop < 0 ? text.length : stop;
      if (end - at > LONGEST_LINE) fail(`line ${number + 1} has ${many(end - at, "letter")}: it is no row of a table`);
      const line = text.slice(at, end).split("#", 1)[0].trim();
      at = end + 1;
      number++;
      if (!line) continue;
      const cells = separator === " " ? line.split(/\s+/) : line.split(separator).map((cell) => cell.trim());
      const values = cells.map(valueOf), wrong = values.indexOf(undefined);
      if (wrong >= 0) {
        if (rows) fail(`line ${number} holds ${quoted(cells[wrong].slice(0, 30))} where a number should be`);
        if (number > 100) fail("its first hundred lines hold no numbers: it is no table of points");
        skipped = number;
        names = cells.map((cell) => cell.toLowerCase().replace(/^"(.*)"$/, "$1"));
        continue;
      }
      if (!rows) {
        columns = values.length;
        kept = choose(columns, names?.length === columns ? names : []);
      }
      if (values.length !== columns) fail(`line ${number} has ${many(values.length, "number")}, the first row has ${columns}`);
      for (const c of kept) numbers.push(values[c]);
      checkCount(++rows);
    }
    return { numbers: Float64Array.from(numbers), rows, columns, kept, separator, skipped };
  }
  function readText(bytes, name, asked) {
    if (bytes.subarray(0, 4096).includes(0)) fail("it is no text: it holds bytes that no letter has");
    const whole = new TextDecoder().decode(bytes), counted = /\.pts$/i.test(name) && /^\s*\d+\s*\n/.test(whole); // .pts begins with the number of points
    const text = counted ? whole.replace(/\d+/, "#") : whole, cut = text.split("\n", FIRST_ROWS + 1);
    const start = table((cut.length > FIRST_ROWS ? cut.slice(0, -1) : cut).join("\n"), (wide) => Array.from({ length: wide }, (_, c) => c));
    let chosen = null;
    const { numbers, rows, columns, kept, separator, skipped } = table(text, (wide, names) => {
      if (wide < 2) fail("it has one number a row; a point has two or three");
      chosen = columnsOf(start.numbers, wide, names, asked);
      return chosen.kept;
    });
    if (!rows) fail("it holds no numbers");
    const options = [quoted(name)];
    if (separator !== " ") options.push(`delimiter=${quoted(separator)}`);
    if (skipped || counted) options.push(`skip_header=${skipped || 1}`);
    if (columns > 3 || chosen.named || !chosen.first) options.push(`usecols=(${kept.join(", ")})`);
    return { clouds: [numbers], columns: kept.length, table: chosen.table, python: `np.genfromtxt(${options.join(", ")})` };
  }

  function readJson(bytes, name, asked) { // lists of points, or a list under the name points
    let value = null;
    try {
      value = JSON.parse(new TextDecoder().decode(bytes));
    } catch (error) {
      fail(`it is no JSON: ${error.message}`);
    }
    const list = Array.isArray(value) ? value : value?.points, shape = [];
    if (!Array.isArray(list)) fail("it holds no list of points, and none under the name points");
    for (let part = list; Array.isArray(part) && shape.length < 5; part = part[0]) shape.push(part.length);
    const flat = list.flat(shape.length - 1), fits = flat.length === shape.reduce((product, size) => product * size, 1);
    if (!fits || !flat.every((v) => v === null || typeof v === "number")) fail("its points are not all of as many numbers");
    const numbers = Float64Array.from(flat, (v) => v ?? NaN), part = list === value ? "" : '["points"]';
    return cloudsOfArray({ shape, numbers }, `np.array(json.loads(Path(${quoted(name)}).read_text())${part}, float)`, asked);
  }

  // ---- depth images --------------------------------------------------------------------------------------------------
  const LENS = ["fx", "fy", "cx", "cy", "width", "height", "depth_scale"];
  async function readPng(bytes, name, asked, lens) { // 16 bits of depth; the lens as `topokit.sensors.read_clouds` has it
    const u4 = (at) => new DataView(bytes.buffer, bytes.byteOffset).getUint32(at), parts = [];
    if (bytes.length < 33 || latin(bytes.subarray(1, 4)) !== "PNG") fail("no whole PNG");
    const [width, height, depth, colour, interlace] = [u4(16), u4(20), bytes[24], bytes[25], bytes[28]];
    if (depth !== 16 || colour !== 0 || interlace) fail("a picture, and no image of depth: that has 16 bits a pixel in one channel");
    if (!lens) fail("a depth image needs its lens: drop a file intrinsics.json with it, with fx, fy, cx and cy in pixels");
    checkCount(width * height);
    for (let at = 8; at + 12 <= bytes.length; at += 12 + u4(at)) {
      if (latin(bytes.subarray(at + 4, at + 8)) === "IDAT") parts.push(bytes.subarray(at + 8, at + 8 + u4(at)));
    }
    const joined = new Uint8Array(await new Blob(parts).arrayBuffer()), wide = 2 * width;
    const rows = await inflate(joined.subarray(2, -4), height * (wide + 1)), out = new Float64Array(3 * width * height), scale = lens.depth_scale ?? 0.001;
    let above = new Uint8Array(wide);
    for (let r = 0; r < height; r++) {
      const filter = rows[r * (wide + 1)], row = rows.subarray(r * (wide + 1) + 1, (r + 1) * (wide + 1));
      for (let i = 0; i < wide; i++) { // each byte is stored as its difference from those at the left and above
        const [left, up, corner] = [i > 1 ? row[i - 2] : 0, above[i], i > 1 ? above[i - 2] : 0], middle = left + up - corner;
        const [byLeft, byUp, byCorner] = [left, up, corner].map((v) => Math.abs(middle - v));
        const paeth = byLeft <= byUp && byLeft <= byCorner ? left : byUp <= byCorner ? up : corner;
        row[i] += [0, left, up, (left + up) >> 1, paeth][filter];
      }
      above = row;
      for (let c = 0; c < width; c++) {
        const z = (256 * row[2 * c] + row[2 * c + 1]) * scale;
        out.set([(z * (c - lens.cx)) / lens.fx, (z * (r - lens.cy)) / lens.fy, z], 3 * (r * width + c));
      }
    }
    if ((lens.width ?? width) !== width || (lens.height ?? height) !== height) fail(`its lens is of an image of ${lens.width} x ${lens.height}, not ${width} x ${height}`);
    return cloudOf(out, "ply");
  }
  async function readLens(file) {
    const lens = JSON.parse(await file.text()), numbers = LENS.filter((key) => key in lens || LENS.indexOf(key) < 4);
    const others = Object.keys(lens).filter((key) => !LENS.includes(key));
    if (others.length) fail(`its lens has ${others.join(", ")}: give fx, fy, cx and cy of a lens without distortion`);
    if (!numbers.every((key) => Number.isFinite(lens[key]))) fail("a lens has the numbers fx, fy, cx and cy, in pixels");
    return lens;
  }

  // ---- vertices of meshes -------------------------------------------------------------------------------------------
  function readObj(bytes, name) {
    const text = latin(bytes), line = /^v[ \t]+([^\r\n]{0,300})/gm, numbers = [];
    for (let found = line.exec(text); found; found = line.exec(text)) {
      const place = found[1].trim().split(/\s+/).slice(0, 3).map(Number);
      if (place.length < 3 || place.some(Number.isNaN)) fail(`a vertex of it is no three numbers: ${found[0].slice(0, 60)}`);
      numbers.push(...place);
      checkCount(numbers.length / 3);
    }
    if (!numbers.length) fail("it has no vertices: no line begins with v");
    return cloudOf(Float64Array.from(numbers), `np.array([line.split()[1:4] for line in open(${quoted(name)}) if line.startswith("v ")], float)`);
  }
  function readStl(bytes, name) { // corners of its triangles; a corner that several share is left out as a repeat
    const count = bytes.length >= 84 ? taker(bytes, "u4", true)(80) : -1, python = `trimesh.load(${quoted(name)}, process=False).vertices`;
    if (bytes.length === 84 + 50 * count) {
      checkCount(3 * count);
      const take = taker(bytes, "f4", true);
      return cloudOf(strided(3 * count, [take, take, take], (i, c) => 84 + 50 * Math.floor(i / 3) + 12 * (1 + (i % 3)) + 4 * c), python);
    }
    const text = latin(bytes.subarray(0, 6)).toLowerCase() === "solid " || /^\s*solid/i.test(latin(bytes.subarray(0, 80))) ? latin(bytes) : "";
    if (!text) fail(`neither a whole binary STL nor a text: ${many(bytes.length, "byte")}, of which its header makes ${many(count, "triangle")}`);
    const numbers = [], corner = /\bvertex\s+(\S+)\s+(\S+)\s+(\S+)/gi;
    for (let found = corner.exec(text); found; found = corner.exec(text)) {
      numbers.push(...found.slice(1, 4).map(Number));
      checkCount(numbers.length / 3);
    }
    const whole = numbers.length > 0 && numbers.length % 9 === 0 && /endsolid/i.test(text.slice(-200));
    if (!whole) fail("cut off or damaged: a triangle of it has not three corners, or endsolid is missing");
    return cloudOf(Float64Array.from(numbers), python);
  }

  // ---- any file ------------------------------------------------------------------------------------------------------
  const READERS = { ply: readPly, pcd: readPcd, npy: readNpy, npz: readNpz, csv: readText, xyz: readText, txt: readText, pts: readText,
    asc: readText, json: readJson, png: readPng, obj: readObj, stl: readStl };
  const trimeshed = (name) => `trimesh.load(${name}, process=False, force="mesh").vertices`, meshed = (name) => `pyvista.read(${name}).points`, lidar = (name) => `laspy.read(${name}).xyz`;
  const ELSEWHERE = { las: lidar, laz: lidar, glb: trimeshed, gltf: trimeshed, off: trimeshed, vtk: meshed, vtp: meshed, vtu: meshed }; // what reads them in Python
  const BAGS = ["bag", "mcap", "db3"];
  function refuse(suffix, name) {
    const saved = quoted(name.replace(/\.\w+$/, ".npy")), kinds = [...Object.keys(READERS), "zip"].map((kind) => "." + kind).join(", ");
    if (suffix in ELSEWHERE) fail(`this page does not read .${suffix}. Python does: import numpy as np, ${/^\w+/.exec(ELSEWHERE[suffix](""))[0]}; np.save(${saved}, ${ELSEWHERE[suffix](quoted(name))}). Then drop ${saved}`);
    if (BAGS.includes(suffix)) fail(`a recording of ROS. Python reads it by the package rosbags: AnyReader([Path(${quoted(name)})]). The page "Coming from ..." has the lines; np.save the clouds, and drop them here`);
    fail(`this page reads ${kinds}`);
  }
  function tidy(numbers, columns) { // places in space without NaN, a camera's zeros and repeats, and how many of each there were
    const rows = numbers.length / columns, out = new Float64Array(3 * rows), left = { rows, notFinite: 0, atZero: 0, repeats: 0 };
    let size = 16;
    while (size < 2 * rows) size *= 2;
    const slots = new Int32Array(size).fill(-1), bits = new Uint32Array(out.buffer);
    let kept = 0;
    for (let i = 0; i < rows; i++) {
      const [x, y] = [numbers[i * columns] + 0, numbers[i * columns + 1] + 0], z = columns > 2 ? numbers[i * columns + 2] + 0 : 0; // + 0: -0 is 0
      if (!(Number.isFinite(x) && Number.isFinite(y) && Number.isFinite(z))) left.notFinite++;
      else if (columns > 2 && x === 0 && y === 0 && z === 0) left.atZero++;
      else {
        out.set([x, y, z], 3 * kept);
        let slot = 0;
        for (let b = 6 * kept; b < 6 * kept + 6; b++) slot = Math.imul(slot ^ bits[b], 0x9e3779b1) ^ (slot >>> 15);
        const same = (other) => out[3 * other] === x && out[3 * other + 1] === y && out[3 * other + 2] === z;
        for (slot = (slot ^ (slot >>> 16)) & (size - 1); slots[slot] >= 0 && !same(slots[slot]); ) slot = (slot + 1) & (size - 1);
        if (slots[slot] >= 0) left.repeats++;
        else slots[slot] = kept++;
      }
    }
    return { points: out.slice(0, 3 * kept), left };
  }
  async function readFile(file, { columns: asked }, lens) {
    const suffix = file.name.includes(".") ? file.name.toLowerCase().split(".").at(-1) : "", megabytes = Math.round(file.size / 2 ** 20);
    if (!(suffix in READERS)) refuse(suffix, file.name);
    if (file.size > MOST_BYTES) fail(`${megabytes.toLocaleString("en")} MB; this page reads up to ${MOST_BYTES / 2 ** 20}: thin the cloud out first`);
    if (!file.size) fail("the file is empty");
    const bytes = new Uint8Array(await file.arrayBuffer()), start = latin(bytes.subarray(0, 60)).trimStart().toLowerCase();
    if (/^version \S+git-lfs/.test(start)) fail("a pointer of git-lfs and not the file itself: fetch it by git lfs pull");
    if (/^<(!doctype|html|\?xml)/.test(start)) fail("a web page and not the file itself");
    const read = await READERS[suffix](bytes, file.name, asked, lens);
    if (read.python === "ply") read.python = `next(read_clouds(${quoted(file.name)}))[1]`;
    if (read.python === "pcd") read.python = `PointCloud.from_path(${quoted(file.name)}).numpy(("x", "y", "z"))`;
    return read;
  }

  async function unpacked(files) { // with what is in .zip files; the lens of depth images; what cannot be unpacked
    const [all, errors, isLens] = [[], [], ({ name }) => /(^|\/)intrinsics\.json$/i.test(name)];
    let lens = null;
    for (const file of files) {
      try {
        if (!/\.zip$/i.test(file.name)) all.push(file);
        else if (file.size > MOST_BYTES) fail(`${Math.round(file.size / 2 ** 20)} MB; this page reads up to ${MOST_BYTES / 2 ** 20}`);
        else {
          const entries = zipEntries(new Uint8Array(await file.arrayBuffer()));
          const names = [...entries.keys()].filter((name) => name.split(".").at(-1).toLowerCase() in READERS && !/(^|\/)(__MACOSX|\.)/.test(name));
          if (!names.length) fail(`it holds no cloud, but ${[...entries.keys()].join(", ").slice(0, 80) || "nothing"}`);
          checkUnpacked(entries, names);
          for (const name of names) all.push(new NamedBlob(name, await entries.get(name)()));
        }
      } catch (error) {
        errors.push(`${file.name}: ${error.message}`);
      }
    }
    try {
      const found = all.length > 1 && all.find(isLens);
      if (found) lens = await readLens(found);
    } catch (error) {
      errors.push(`intrinsics.json: ${error.message}`);
    }
    return { all: all.length > 1 ? all.filter((file) => !isLens(file)) : all, lens, errors };
  }
  class NamedBlob extends Blob { // a file of a .zip, by its path
    constructor(name, bytes) {
      super([bytes]);
      this.name = name;
    }
  }

  // ---- frames --------------------------------------------------------------------------------------------------------
  const MOST_USED = 800, MOST_AROUND = 4000, MOST_ERRORS = 20;
  function someOf(points, frames) { // to be seen around those that are used
    const count = points.length / 3, step = Math.ceil((count * Math.min(frames, 4)) / MOST_AROUND) || 1, around = new Float32Array(3 * Math.ceil(count / step));
    for (let i = 0; i < around.length; i += 3) around.set(points.subarray(i * step, i * step + 3), i);
    return around;
  }
  function thinned(numbers, columns, frames = 1, where = "", cuts = {}) { // up to 800 farthest points in their order; all points, where there are no more
    const { points: whole, left } = tidy(numbers, columns), { kept: points, off, outside, onPlane } = cutAway(whole, cuts), count = points.length / 3;
    Object.assign(left, { outside, onPlane });
    const gone = { "not finite": left.notFinite, "at zero": left.atZero, "outside the box": outside, "on a plane": onPlane };
    const reasons = Object.entries(gone).filter(([, number]) => number).map(([why, number]) => `${number.toLocaleString("en")} ${why}`).join(", ");
    if (!count) fail(`${where}none of its ${many(left.rows, "point")} would be left${reasons ? `: ${reasons}` : ""}`);
    const { ids, radii } = farthestPoints(points, count, 3, Math.min(count, MOST_USED)), all = count > MOST_USED ? null : points;
    return { count, order: subcloud(points, 3, ids), radii, all, around: someOf(points, frames), off: someOf(off, frames), middle: middleOf(whole), left };
  }
  async function planeOf({ numbers, columns, files, name, at }, options) { // of numbers, or of a frame of a file, after the cuts that are made already
    const { all, lens } = await unpacked(files ?? []);
    const read = files ? await readFile(all.find((file) => file.name === name), options, lens) : { clouds: [numbers], columns };
    return largestPlane(cutAway(tidy(read.clouds[at], read.columns).points, options).kept, options.thickness);
  }
  // Of a file, or of several in natural order. A file that cannot be read is left out and named.
  // Options: columns, the three or two that are a place; crop and planes, as `cutAway` has them.
  async function readFilm(files, { onProgress = () => {}, ...options } = {}) {
    const { all, lens, errors } = await unpacked(files);
    const sorted = all.sort((a, b) => new Intl.Collator("en", { numeric: true }).compare(a.name, b.name));
    const film = { names: [], frames: [], errors, columns: 3, python: "", table: null, several: all.length > 1, zips: files.map(({ name }) => name).filter((name) => /\.zip$/i.test(name)) };
    for (const [k, file] of sorted.entries()) {
      try {
        if (k >= MOST_FRAMES) fail(`file number ${k + 1}; a film has up to ${MOST_FRAMES.toLocaleString("en")} frames`);
        const { clouds, columns, film: whole, python, table: columnsThere = null } = await readFile(file, options, lens);
        if (film.several && clouds.length > 1) fail(`it is a film of ${clouds.length} frames; give it alone`);
        for (const [t, numbers] of clouds.entries()) {
          onProgress((k + t / clouds.length) / sorted.length);
          film.frames.push(thinned(numbers, columns, sorted.length * clouds.length, clouds.length > 1 ? `frame ${t}: ` : "", options));
        }
        film.names.push(file.name);
        Object.assign(film, { columns, python: film.python || python, whole, table: film.table ?? columnsThere });
      } catch (error) {
        if (!film.several) film.frames = []; // a film with a bad frame
        film.errors.push(`${file.name}: ${error.message}`);
      }
    }
    const more = film.errors.splice(MOST_ERRORS).length;
    if (more) film.errors.push(`and ${more.toLocaleString("en")} more`);
    return film;
  }
  return { readFilm, thinned, planeOf };
}
