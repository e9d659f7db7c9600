//! Decoder for pickles of numeric lists, as in calibration columns. Nothing is ever executed.
//!
//! # How it works
//! nuPlan stores a translation, rotation or intrinsic matrix as a Python pickle (protocol 2 to 5) of a list,
//! or of a list subclass. A pickle is a program for a stack machine. Only the instructions that build lists
//! of numbers are implemented. A class is accepted only to create an empty list. Any other instruction or
//! class is an error. Source: Python's `pickletools`.

/// Number or list.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    Number(f64),
    List(Vec<Value>),
}

/// Formats the first values, for messages.
impl std::fmt::Display for Value {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        const SHOWN: usize = 9;
        let values = match self {
            Self::Number(number) => return write!(f, "{number}"),
            Self::List(values) => values,
        };
        let shown: Vec<String> = values.iter().take(SHOWN).map(ToString::to_string).collect();
        let rest = if values.len() > SHOWN { ", .." } else { "" };
        write!(f, "[{}{rest}]", shown.join(", "))
    }
}

/// Reason why bytes are not a pickle of numeric lists.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(super) enum PickleError {
    #[error("{0} bytes where at most {MAX_BYTES} are taken")]
    Long(usize),
    #[error("the end of the pickle after {0} bytes")]
    Truncated(usize),
    #[error("opcode {code:#04x} ({name}) at byte {at}")]
    Opcode { code: u8, name: &'static str, at: usize },
    #[error("protocol {0}")]
    Protocol(u8),
    #[error("class {0}")]
    Class(String),
    #[error("{0} that does not fit at byte {1}")]
    Misplaced(&'static str, usize),
    #[error("lists nested deeper than {MAX_DEPTH}")]
    Deep,
    #[error("{0} bytes after the end")]
    Trailing(usize),
}

/// Maximum length of a pickle; real ones have about 160 bytes.
const MAX_BYTES: usize = 4096;
/// Maximum nesting of lists; a matrix has two levels.
const MAX_DEPTH: usize = 4;
/// Module of the accepted list classes.
const MODULE: &str = "nuplan.database.common.data_types";
const CLASSES: [&str; 3] = ["Translation", "Rotation", "CameraIntrinsic"];

impl Value {
    /// Returns the numbers in a list with exactly `N` entries.
    pub(super) fn vector<const N: usize>(&self) -> Option<[f64; N]> {
        self.numbers()?.try_into().ok()
    }

    /// Returns the numbers of a list.
    pub(super) fn numbers(&self) -> Option<Vec<f64>> {
        self.list()?.iter().map(Self::number).collect()
    }

    /// Returns the rows in a list that contains lists.
    pub(super) fn matrix<const N: usize, const M: usize>(&self) -> Option<[[f64; M]; N]> {
        self.list()?.iter().map(Self::vector).collect::<Option<Vec<_>>>()?.try_into().ok()
    }

    fn number(&self) -> Option<f64> {
        match self {
            Self::Number(number) => Some(*number),
            Self::List(_) => None,
        }
    }

    fn list(&self) -> Option<&[Self]> {
        match self {
            Self::List(values) => Some(values),
            Self::Number(_) => None,
        }
    }

    fn depth(&self) -> usize {
        self.list().map_or(0, |values| 1 + values.iter().map(Self::depth).max().unwrap_or(0))
    }
}

/// Decodes a pickle.
///
/// # Errors
/// Fails if the content is not a list of numbers and lists, or uses instructions that nuPlan's pickles lack.
pub(super) fn decode(bytes: &[u8]) -> Result<Value, PickleError> {
    if bytes.len() > MAX_BYTES {
        return Err(PickleError::Long(bytes.len()));
    }
    let mut machine = Machine { bytes, at: 0, stack: Vec::new() };
    loop {
        let at = machine.at;
        let [code] = machine.take()?;
        if code == b'.' {
            return machine.finish(at);
        }
        machine.step(code, at)?;
    }
}

/// Item of the machine's stack.
enum Item {
    Mark,
    Text(String),
    Class,
    NoArguments,
    Value(Value),
}

struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    stack: Vec<Item>,
}

impl Machine<'_> {
    fn step(&mut self, code: u8, at: usize) -> Result<(), PickleError> {
        match code {
            0x80 => self.protocol(),
            0x95 => self.take::<8>().map(|_| ()), // FRAME: its length only helps stream readers
            // MEMOIZE, BINPUT, LONG_BINPUT: memoized values are never used here.
            0x94 => Ok(()),
            b'q' => self.take::<1>().map(|_| ()),
            b'r' => self.take::<4>().map(|_| ()),
            b'(' => self.push(Item::Mark),
            b')' => self.push(Item::NoArguments),
            b']' => self.push(Item::Value(Value::List(Vec::new()))),
            b'G' => self.take().map(f64::from_be_bytes).and_then(|v| self.number(v)),
            b'J' => self.take().map(i32::from_le_bytes).and_then(|v| self.number(f64::from(v))),
            b'M' => self.take().map(u16::from_le_bytes).and_then(|v| self.number(f64::from(v))),
            b'K' => self.take().map(u8::from_le_bytes).and_then(|v| self.number(f64::from(v))),
            0x8c => self.take().map(u8::from_le_bytes).and_then(|length| self.text(length.into(), at)),
            b'X' => self.take().map(u32::from_le_bytes).and_then(|length| self.text(length, at)),
            0x93 => self.class(at),
            b'c' => self.class_by_lines(at),
            0x81 => self.new_list(at),
            b'a' => self.append(at),
            b'e' => self.append_all(at),
            _ => Err(PickleError::Opcode { code, name: opcode_name(code), at }),
        }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], PickleError> {
        let taken = self.bytes.get(self.at..).and_then(|rest| rest.first_chunk::<N>());
        self.at += N;
        taken.copied().ok_or(PickleError::Truncated(self.bytes.len()))
    }

    fn push(&mut self, item: Item) -> Result<(), PickleError> {
        self.stack.push(item);
        Ok(())
    }

    fn number(&mut self, value: f64) -> Result<(), PickleError> {
        self.push(Item::Value(Value::Number(value)))
    }

    fn protocol(&mut self) -> Result<(), PickleError> {
        let [version] = self.take()?;
        if matches!(version, 2..=5) { Ok(()) } else { Err(PickleError::Protocol(version)) }
    }

    fn text(&mut self, length: u32, at: usize) -> Result<(), PickleError> {
        let end = usize::try_from(length).ok().and_then(|length| self.at.checked_add(length));
        let bytes = end.and_then(|end| self.bytes.get(self.at..end));
        let bytes = bytes.ok_or(PickleError::Truncated(self.bytes.len()))?;
        self.at += bytes.len();
        let text = utf8(bytes, at)?.to_owned();
        self.push(Item::Text(text))
    }

    /// STACK_GLOBAL: a module and a class name from the stack.
    fn class(&mut self, at: usize) -> Result<(), PickleError> {
        let (Some(Item::Text(name)), Some(Item::Text(module))) = (self.stack.pop(), self.stack.pop()) else {
            return Err(PickleError::Misplaced("STACK_GLOBAL", at));
        };
        self.known_class(&module, &name)
    }

    /// GLOBAL: the same, as two lines after the instruction.
    fn class_by_lines(&mut self, at: usize) -> Result<(), PickleError> {
        let (bytes, mut lines) = (self.bytes, [""; 2]);
        for line in &mut lines {
            let rest = bytes.get(self.at..).unwrap_or_default();
            let length = rest.iter().position(|b| *b == b'\n');
            let length = length.ok_or(PickleError::Truncated(bytes.len()))?;
            *line = utf8(&rest[..length], at)?;
            self.at += length + 1;
        }
        self.known_class(lines[0], lines[1])
    }

    fn known_class(&mut self, module: &str, name: &str) -> Result<(), PickleError> {
        if module != MODULE || !CLASSES.contains(&name) {
            return Err(PickleError::Class(format!("{module}.{name}")));
        }
        self.push(Item::Class)
    }

    /// NEWOBJ: accepted classes are lists, created without arguments.
    fn new_list(&mut self, at: usize) -> Result<(), PickleError> {
        let (Some(Item::NoArguments), Some(Item::Class)) = (self.stack.pop(), self.stack.pop()) else {
            return Err(PickleError::Misplaced("NEWOBJ", at));
        };
        self.push(Item::Value(Value::List(Vec::new())))
    }

    fn append(&mut self, at: usize) -> Result<(), PickleError> {
        let Some(Item::Value(value)) = self.stack.pop() else {
            return Err(PickleError::Misplaced("APPEND", at));
        };
        self.extend("APPEND", at, vec![value])
    }

    /// APPENDS: appends all values since the last mark.
    fn append_all(&mut self, at: usize) -> Result<(), PickleError> {
        let mut values = Vec::new();
        loop {
            match self.stack.pop() {
                Some(Item::Value(value)) => values.push(value),
                Some(Item::Mark) => break,
                _ => return Err(PickleError::Misplaced("APPENDS", at)),
            }
        }
        values.reverse();
        self.extend("APPENDS", at, values)
    }

    fn extend(&mut self, name: &'static str, at: usize, values: Vec<Value>) -> Result<(), PickleError> {
        // Check before nesting: dropping a very deep list would overflow the stack.
        if values.iter().any(|value| value.depth() >= MAX_DEPTH) {
            return Err(PickleError::Deep);
        }
        let Some(Item::Value(Value::List(list))) = self.stack.last_mut() else {
            return Err(PickleError::Misplaced(name, at));
        };
        list.extend(values);
        Ok(())
    }

    /// STOP: exactly one list must remain, without trailing bytes.
    fn finish(mut self, at: usize) -> Result<Value, PickleError> {
        let left = self.bytes.len() - self.at;
        match (self.stack.pop(), self.stack.pop(), left) {
            (Some(Item::Value(value @ Value::List(_))), None, 0) => Ok(value),
            (Some(Item::Value(Value::List(_))), None, left) => Err(PickleError::Trailing(left)),
            _ => Err(PickleError::Misplaced("STOP", at)),
        }
    }
}

fn utf8(bytes: &[u8], at: usize) -> Result<&str, PickleError> {
    str::from_utf8(bytes).map_err(|_| PickleError::Misplaced("text that is no UTF-8", at))
}

/// Returns the names of rejected instructions.
fn opcode_name(code: u8) -> &'static str {
    match code {
        b'0' => "POP",
        b'1' => "POP_MARK",
        b'2' => "DUP",
        b'B' => "BINBYTES",
        b'C' => "SHORT_BINBYTES",
        b'F' => "FLOAT",
        b'I' => "INT",
        b'L' => "LONG",
        b'N' => "NONE",
        b'P' => "PERSID",
        b'Q' => "BINPERSID",
        b'R' => "REDUCE",
        b'S' => "STRING",
        b'T' => "BINSTRING",
        b'U' => "SHORT_BINSTRING",
        b'V' => "UNICODE",
        b'b' => "BUILD",
        b'd' => "DICT",
        b'g' => "GET",
        b'h' => "BINGET",
        b'i' => "INST",
        b'j' => "LONG_BINGET",
        b'l' => "LIST",
        b'o' => "OBJ",
        b'p' => "PUT",
        b's' => "SETITEM",
        b't' => "TUPLE",
        b'u' => "SETITEMS",
        b'}' => "EMPTY_DICT",
        0x82 => "EXT1",
        0x83 => "EXT2",
        0x84 => "EXT4",
        0x85 => "TUPLE1",
        0x86 => "TUPLE2",
        0x87 => "TUPLE3",
        0x88 => "NEWTRUE",
        0x89 => "NEWFALSE",
        0x8a => "LONG1",
        0x8b => "LONG4",
        0x8d => "BINUNICODE8",
        0x8e => "BINBYTES8",
        0x8f => "EMPTY_SET",
        0x90 => "ADDITEMS",
        0x91 => "FROZENSET",
        0x92 => "NEWOBJ_EX",
        0x96 => "BYTEARRAY8",
        0x97 => "NEXT_BUFFER",
        0x98 => "READONLY_BUFFER",
        _ => "unknown",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    // Created by Python's `pickle` with protocols 4, 4, 5.
    const TRANSLATION: &str = "8004954b000000000000008c216e75706c616e2e64617461626173652e636f6d6d6f6e2e64617\
        4615f7479\
        706573948c0b5472616e736c6174696f6e94939429819428473ff80000000000004afeffffff4d2c01652e";
    const INTRINSIC: &str = "80049586000000000000008c216e75706c616e2e64617461626173652e636f6d6d6f6e2e6461746\
        15f747970\
        6573948c0f43616d657261496e7472696e736963949394298194285d94284740982400000000004700000000000000004740\
        8e000000\
        000000655d9428470000000000000000474098240000000000474081800000000000655d94284b004b004b0165652e";
    const DISTORTION: &str = "80059532000000000000005d942847bfd6cab81f969e3d473fc615f45e0b4e1247bf6172ef0ae5\
        3650473f3e\
        68a0d349be9047bfaac8605681ecd5652e";
    // Another class of the same module, and `os.system("true")` as returned by `__reduce__`.
    const OTHER: &str = "8004953c000000000000008c216e75706c616e2e64617461626173652e636f6d6d6f6e2e646174615f7\
        479706573\
        948c054f74686572949394298194473ff0000000000000612e";
    const REDUCE: &str =
        "8004951f000000000000008c05706f736978948c0673797374656d9493948c047472756594859452942e";

    // The same with protocols 2, 3, 2.
    const TRANSLATION_2: &str = "8002636e75706c616e2e64617461626173652e636f6d6d6f6e2e646174615f74797065730a5\
        472616e736c6174696f6e0a71002981710128473ff80000000000004afeffffff4d2c01652e";
    const INTRINSIC_3: &str = "8003636e75706c616e2e64617461626173652e636f6d6d6f6e2e646174615f74797065730a436\
        16d657261496e7472696e7369630a710029817101285d71022847409824000000000047000000000000000047408e0000000\
        00000655\
        d710328470000000000000000474098240000000000474081800000000000655d7104284b004b004b0165652e";
    const REDUCE_2: &str = "800263706f7369780a73797374656d0a710058040000007472756571018571025271032e";

    fn bytes(hex: &str) -> Vec<u8> {
        (0..hex.len() / 2).map(|i| u8::from_str_radix(&hex[2 * i..2 * i + 2], 16).unwrap()).collect()
    }

    #[test]
    fn calibration_is_decoded() {
        assert_eq!(decode(&bytes(TRANSLATION)).unwrap().vector(), Some([1.5, -2.0, 300.0]));
        let rows = [[1545.0, 0.0, 960.0], [0.0, 1545.0, 560.0], [0.0, 0.0, 1.0]];
        assert_eq!(decode(&bytes(INTRINSIC)).unwrap().matrix(), Some(rows));
        let distortion = decode(&bytes(DISTORTION)).unwrap();
        assert_eq!(distortion.vector(), Some([-0.356123, 0.172545, -0.00213, 0.000464, -0.05231]));
        assert_eq!(distortion.vector::<4>(), None);
        assert_eq!(distortion.matrix::<1, 5>(), None);
        assert_eq!(
            decode(&bytes(INTRINSIC)).unwrap().to_string(),
            "[[1545, 0, 960], [0, 1545, 560], [0, 0, 1]]"
        );
        assert_eq!(decode(&bytes(TRANSLATION_2)).unwrap().vector(), Some([1.5, -2.0, 300.0]));
        assert_eq!(decode(&bytes(INTRINSIC_3)).unwrap().matrix(), Some(rows));
        assert_eq!(decode(b"\x80\x02]r\x00\x01\x00\x00K\x07a.").unwrap().vector(), Some([7.0]));
        assert_eq!(decode(b"\x80\x04]K\x07a.").unwrap().vector(), Some([7.0]));
    }

    #[test]
    fn other_pickle_instructions_are_rejected_by_name() {
        let message = |bytes: &[u8]| decode(bytes).unwrap_err().to_string();
        assert_eq!(message(&bytes(REDUCE)), "class posix.system");
        assert_eq!(message(&bytes(OTHER)), "class nuplan.database.common.data_types.Other");
        assert_eq!(message(b"\x80\x04]R."), "opcode 0x52 (REDUCE) at byte 3");
        assert_eq!(message(b"\x80\x04cos\nsystem\n."), "class os.system");
        assert_eq!(message(b"\x80\x02cos\nsystem"), "the end of the pickle after 12 bytes");
        assert_eq!(message(b"\x80\x02c\xff\nsystem\n."), "text that is no UTF-8 that does not fit at byte 2");
        assert_eq!(message(&bytes(REDUCE_2)), "class posix.system");
        assert_eq!(message(b"\x80\x02X\xff\xff\xff\xffab"), "the end of the pickle after 9 bytes");
        assert_eq!(message(b"\x80\x02]q\x00h\x00."), "opcode 0x68 (BINGET) at byte 5");
        assert_eq!(
            message(b"\x80\x02]r\x00\x00\x00\x00j\x00\x00\x00\x00."),
            "opcode 0x6a (LONG_BINGET) at byte 8"
        );
        assert_eq!(message(b"\x80\x02X\x01\x00\x00\x00a."), "STOP that does not fit at byte 8");
        assert_eq!(message(b"\x80\x04]b."), "opcode 0x62 (BUILD) at byte 3");
        assert_eq!(message(b"\x80\x04\xff."), "opcode 0xff (unknown) at byte 2");
        assert_eq!(message(b"\x80\x01]."), "protocol 1");
        assert_eq!(message(b"\x80\x06]."), "protocol 6");
        assert_eq!(message(b"\x80\x04]].."), "STOP that does not fit at byte 4");
        assert_eq!(message(b"\x80\x04]..."), "2 bytes after the end");
        assert_eq!(message(b"\x80\x04K\x01."), "STOP that does not fit at byte 4");
        assert_eq!(message(b"\x80\x04e."), "APPENDS that does not fit at byte 2");
        assert_eq!(message(b"\x80\x04a."), "APPEND that does not fit at byte 2");
        assert_eq!(message(b"\x80\x04])\x81."), "NEWOBJ that does not fit at byte 4");
        assert_eq!(message(&[b']'; MAX_BYTES + 1]), "4097 bytes where at most 4096 are taken");
        let nested = [[b']'; 900].as_slice(), &[b'a'; 899], b"."].concat();
        assert_eq!(message(&nested), "lists nested deeper than 4");
    }

    /// Every unknown opcode is rejected.
    #[test]
    fn known_opcodes_are_few() {
        let known = b"\x80\x95\x94qr()]GJMK\x8cX\x93c\x81ae.";
        for code in 0..=u8::MAX {
            let result = decode(&[code, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
            let refused = matches!(result, Err(PickleError::Opcode { at: 0, .. }));
            assert_eq!(refused, !known.contains(&code), "{code:#x}");
        }
    }

    #[test]
    fn truncated_pickles_are_refused() {
        for whole in [TRANSLATION, INTRINSIC, DISTORTION, TRANSLATION_2, INTRINSIC_3].map(bytes) {
            for cut in 0..whole.len() {
                assert!(decode(&whole[..cut]).is_err(), "{cut} of {}", whole.len());
            }
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_list_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            prop_assert!(decode(&bytes).is_err() || bytes.ends_with(b"."));
        }

        /// Mostly known instructions, so decoding gets far.
        #[test]
        fn any_instructions_are_a_list_or_an_error(
            bytes in proptest::collection::vec(
                proptest::sample::select(b"()]aeK\x81\x93\x94.".as_slice()), 0..300),
        ) {
            if let Ok(value) = decode(&bytes) {
                prop_assert!((1..=MAX_DEPTH).contains(&value.depth()));
            }
        }

        #[test]
        fn a_changed_byte_is_a_list_or_an_error(at in 0..120_usize, to in any::<u8>()) {
            let mut bytes = bytes(INTRINSIC);
            bytes[at] = to;
            prop_assert!(decode(&bytes).is_err() || bytes.ends_with(b"."));
        }
    }
}
