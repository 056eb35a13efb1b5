// Where in a JSON text the value of each pointer (RFC 6901) stands, and where a text stops being JSON.

export class NotJson extends Error {
  constructor(words, at) {
    super(words);
    this.at = at;
  }
}

const SPACE = /[ \t\r\n]*/y;
const STRING = /"(?:[^"\\\u0000-\u001f]|\\(?:["\\/bfnrt]|u[0-9a-fA-F]{4}))*"/y;
const PLAIN = /-?(?:0|[1-9]\d*)(?:\.\d+)?(?:[eE][-+]?\d+)?|true|false|null/y;
const MAX_DEPTH = 64;

export function lineOf(text, at) {
  let line = 1;
  for (let i = text.indexOf("\n"); i !== -1 && i < at; i = text.indexOf("\n", i + 1)) line += 1;
  return line;
}

// Returns a map from pointer to offset; throws `NotJson` with the offset of what is wrong.
export function places(text) {
  const found = new Map();
  let at = 0;

  const take = (pattern) => {
    pattern.lastIndex = at;
    const match = pattern.exec(text);
    if (match) at = pattern.lastIndex;
    return match && match[0];
  };
  const here = () => (at >= text.length ? "the text ends" : `there is ${JSON.stringify(text[at])}`);
  const fail = (wanted) => {
    throw new NotJson(`${wanted} was expected, but ${here()}`, at);
  };

  function value(pointer, depth) {
    take(SPACE);
    found.set(pointer, at);
    if (depth > MAX_DEPTH) throw new NotJson("nested too deeply", at);
    const first = text[at];
    if (first === "{") object(pointer, depth);
    else if (first === "[") array(pointer, depth);
    else if (first === '"') {
      if (take(STRING) === null) throw new NotJson("this text has no end, or a character that must be escaped", at);
    } else if (take(PLAIN) === null) fail("a value");
    take(SPACE);
  }
  function object(pointer, depth) {
    at += 1;
    take(SPACE);
    if (text[at] === "}") return void (at += 1);
    for (;;) {
      take(SPACE);
      const start = at;
      const name = take(STRING);
      if (name === null) fail('a key in double quotes');
      const child = `${pointer}/${JSON.parse(name).replaceAll("~", "~0").replaceAll("/", "~1")}`;
      take(SPACE);
      if (text[at] !== ":") fail("a colon");
      at += 1;
      value(child, depth + 1);
      found.set(child, start); // the line of the key
      if (text[at] === "}") return void (at += 1);
      if (text[at] !== ",") fail("a comma or }");
      at += 1;
    }
  }
  function array(pointer, depth) {
    at += 1;
    take(SPACE);
    if (text[at] === "]") return void (at += 1);
    for (let index = 0; ; index += 1) {
      value(`${pointer}/${index}`, depth + 1);
      if (text[at] === "]") return void (at += 1);
      if (text[at] !== ",") fail("a comma or ]");
      at += 1;
    }
  }

  value("", 0);
  if (at < text.length) fail("nothing more");
  return found;
}

// Returns the offset of a pointer, or of the nearest value above it that the text has.
export function locate(found, pointer) {
  for (let above = pointer; ; above = above.slice(0, above.lastIndexOf("/"))) {
    if (found.has(above)) return found.get(above);
    if (!above) return 0;
  }
}
