//! Parameters of a node as a text file, and how a node gets those of a file.
//!
//! A line has a name and a number: what the DroneCAN GUI Tool, MAVProxy and Mission Planner read
//! and write. A boolean is 1 or 0. Those programs take no text for a number, so a text is in a
//! comment, which only this page reads: `#text NAME the text`. Each comment has two words, because
//! the GUI Tool takes a line with one for an error. A line of QGroundControl has five words, which
//! are read, too: vehicle, component, name, value and type.
//!
//! Sources: `node_properties.py` of the DroneCAN GUI Tool, `mavparm.py` of pymavlink,
//! `ParamFile.cs` of Mission Planner and `ParameterManager.cc` of QGroundControl.

use std::collections::VecDeque;

use bench::dronecan::{ParameterResponse, Value};

use crate::traffic::shown;

/// Begins the line of a text.
const TEXT: &str = "#text ";
/// Parameters that are node IDs, of this project, of AP_Periph and of others.
const NODE_IDS: [&str; 3] = ["NODE_ID", "CAN_NODE", "uavcan.node.id"];
/// Maximum number of lines of a file.
const LINES_MAX: usize = 5000;
/// Longest text about a parameter that the page shows.
const PROBLEM_MAX: usize = 200;

/// The file with these parameters. `title` is its first line, a comment.
pub fn write(title: &str, parameters: &[ParameterResponse]) -> String {
    let mut file = format!("# {title}\n");
    for parameter in parameters {
        let name = parameter.name();
        let is_word = |letter: char| letter.is_ascii_graphic() && letter != ',';
        if !name.chars().all(is_word) || name.is_empty() || name.starts_with('#') {
            file += &format!("# not written: {}\n", name.escape_debug());
            continue;
        }
        file += &match &parameter.value {
            Value::Empty => continue,
            Value::Boolean(is_set) => format!("{name} {}\n", u8::from(*is_set)),
            Value::Text(text) => format!("{TEXT}{name} {}\n", text.escape_ascii()),
            number => format!("{name} {number}\n"),
        };
    }
    file
}

/// A parameter of a file.
#[derive(Clone, Debug, PartialEq)]
struct Entry {
    name: String,
    written: Written,
}

/// The value of a parameter as it is in a file.
#[derive(Clone, Debug, PartialEq)]
enum Written {
    /// The rest of a line.
    Plain(String),
    Text(Vec<u8>),
}

/// Reads a file: its parameters, of which the last with a name counts, and the numbers of the lines
/// that are none.
fn read(file: &str) -> (Vec<Entry>, Vec<usize>) {
    let (mut entries, mut wrong): (Vec<Entry>, _) = (Vec::new(), Vec::new());
    for (index, line) in file.lines().enumerate() {
        let is_separator = |letter: char| letter.is_whitespace() || letter == ',';
        let entry = if let Some(line) = line.strip_prefix(TEXT) {
            let (name, text) = line.split_once(' ').unwrap_or((line, ""));
            Some(Entry { name: name.into(), written: Written::Text(unescaped(text)) })
        } else if line.trim().is_empty() || line.starts_with('#') {
            continue;
        } else if let [vehicle, component, name, value, _] =
            line.split('\t').collect::<Vec<_>>()[..]
            && [vehicle, component].iter().all(|id| id.parse::<u8>().is_ok())
        {
            Some(Entry { name: name.into(), written: Written::Plain(value.into()) })
        } else {
            let split = line.trim().split_once(is_separator);
            split.map(|(name, rest)| Entry {
                name: name.into(),
                written: Written::Plain(rest.trim_matches(is_separator).into()),
            })
        };
        let Some(entry) = entry else {
            wrong.push(index + 1);
            continue;
        };
        entries.retain(|known| known.name != entry.name);
        entries.push(entry);
    }
    (entries, wrong)
}

/// The bytes that [`u8::escape_ascii`] has written.
fn unescaped(text: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut rest = text.as_bytes();
    while let [first, tail @ ..] = rest {
        let (byte, length) = match (first, tail) {
            (b'\\', [b'x', high, low, ..]) => {
                let digit = |digit: u8| char::from(digit).to_digit(16);
                match (digit(*high), digit(*low)) {
                    (Some(high), Some(low)) => ((high << 4 | low) as u8, 4),
                    _ => (b'\\', 1),
                }
            }
            (b'\\', [b't', ..]) => (b'\t', 2),
            (b'\\', [b'r', ..]) => (b'\r', 2),
            (b'\\', [b'n', ..]) => (b'\n', 2),
            (b'\\', [other, ..]) => (*other, 2),
            _ => (*first, 1),
        };
        bytes.push(byte);
        rest = &rest[length..];
    }
    bytes
}

impl Written {
    /// The value for a parameter whose value is `like`.
    ///
    /// # Errors
    /// If it is no value of that type; the text says which are.
    fn value(&self, like: &Value) -> Result<Value, String> {
        let (word, text) = match self {
            Written::Plain(rest) => {
                (rest.split_whitespace().next().unwrap_or_default(), rest.as_bytes())
            }
            Written::Text(text) => ("a text", text.as_slice()),
        };
        let value = match like {
            Value::Integer(_) => whole(word).map(Value::Integer).ok_or("a whole number"),
            Value::Real(_) => word.parse().map(Value::Real).map_err(|_| "a number"),
            Value::Boolean(_) => boolean(word).map(Value::Boolean).ok_or("1 or 0"),
            Value::Text(_) => Ok(Value::Text(text.into())),
            Value::Empty => Err("no value"),
        };
        value.map_err(|what| format!("takes {what}, not \"{}\"", text.escape_ascii()))
    }
}

/// A whole number, also as ground stations write it: `1500.000000`, `0x5DC`.
fn whole(word: &str) -> Option<i64> {
    let hexadecimal = word.strip_prefix("0x").or_else(|| word.strip_prefix("0X"));
    if let Some(digits) = hexadecimal {
        return i64::from_str_radix(digits, 16).ok();
    }
    let (digits, fraction) = word.split_once('.').unwrap_or((word, ""));
    fraction.bytes().all(|digit| digit == b'0').then(|| digits.parse().ok())?
}

fn boolean(word: &str) -> Option<bool> {
    match word.to_ascii_lowercase().as_str() {
        "true" => Some(true),
        "false" => Some(false),
        _ => whole(word).filter(|number| matches!(number, 0 | 1)).map(|number| number == 1),
    }
}

/// True if a node has the value that it was asked for. A real number may be rounded.
fn is_taken(asked: &Value, has: &Value) -> bool {
    match (asked, has) {
        (Value::Real(asked), Value::Real(has)) => {
            (asked - has).abs() <= 1e-6 * asked.abs().max(1.0)
        }
        _ => asked == has,
    }
}

/// The parameters of a file on their way to a node, one after the other. Those that the node
/// refuses are tried once more after the others: some depend on others.
pub struct Loading {
    entries: Vec<Entry>,
    /// Node IDs that other nodes have.
    others: Vec<u8>,
    waiting: VecDeque<(String, Value)>,
    /// Those that the node refused in the first round.
    refused: Vec<(String, Value)>,
    is_second: bool,
    set: usize,
    same: usize,
    problems: Vec<String>,
}

impl Loading {
    /// Reads a file.
    ///
    /// # Errors
    /// If it has none, or too many lines.
    pub fn new(file: &str, others: Vec<u8>) -> Result<Loading, String> {
        if file.lines().count() > LINES_MAX {
            return Err(format!("the file has more than {LINES_MAX} lines"));
        }
        let (entries, wrong) = read(file);
        if entries.is_empty() {
            return Err(String::from("the file has no lines with a name and a number"));
        }
        let problems = wrong.iter().map(|line| format!("line {line} has no value")).collect();
        Ok(Loading {
            entries,
            others,
            waiting: VecDeque::new(),
            refused: Vec::new(),
            is_second: false,
            set: 0,
            same: 0,
            problems,
        })
    }

    /// Compares the file with all parameters of the node, which were read before.
    pub fn begin(&mut self, parameters: &[ParameterResponse]) {
        for Entry { name, written } in std::mem::take(&mut self.entries) {
            let Some(known) = parameters.iter().find(|known| known.name() == name) else {
                self.problems.push(format!("{name} is no parameter of the node"));
                continue;
            };
            match written.value(&known.value) {
                Err(why) => self.problems.push(format!("{name} {why}")),
                Ok(value) if is_taken(&value, &known.value) => self.same += 1,
                Ok(Value::Integer(id))
                    if NODE_IDS.contains(&name.as_str())
                        && self.others.iter().any(|other| i64::from(*other) == id) =>
                {
                    let problem = format!("{name} {id} is not set: another node has this ID");
                    self.problems.push(problem);
                }
                Ok(value) => self.waiting.push_back((name, value)),
            }
        }
    }

    /// The next parameter to set. None if one was asked for, or if all is done.
    pub fn next_to_set(&mut self) -> Option<(String, Value)> {
        if self.waiting.is_empty() && !self.is_second {
            self.is_second = true;
            self.waiting.extend(self.refused.drain(..));
        }
        self.waiting.front().cloned()
    }

    /// Notes the node's answer to the parameter that [`Loading::next_to_set`] returned. False if it
    /// is another one.
    pub fn answered(&mut self, name: &str, has: &Value) -> bool {
        let Some((name, asked)) = self.waiting.pop_front_if(|(asked, _)| asked == name) else {
            return false;
        };
        if is_taken(&asked, has) {
            self.set += 1;
        } else if self.is_second {
            self.problems.push(format!("{name} {asked} was refused: the node keeps {has}"));
        } else {
            self.refused.push((name, asked));
        }
        true
    }

    /// Gives up, because the node does not answer or the user stops.
    pub fn abandon(&mut self) {
        let left = self.waiting.drain(..).chain(self.refused.drain(..));
        self.problems.extend(left.map(|(name, value)| format!("{name} {value} is not set")));
        let unread = self.entries.drain(..);
        self.problems.extend(unread.map(|Entry { name, .. }| format!("{name} is not set")));
    }

    /// What happened, in words.
    pub fn summary(&self) -> String {
        let not = match self.problems.len() {
            0 => String::new(),
            count => format!(", {count} NOT"),
        };
        format!("from the file: {} set, {} were so before{not}", self.set, self.same)
    }

    /// What is not as in the file, and why.
    pub fn problems(&self) -> Vec<String> {
        self.problems.iter().map(|problem| shown(problem, PROBLEM_MAX)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parameter(name: &str, value: Value) -> ParameterResponse {
        ParameterResponse { name: name.into(), value, ..ParameterResponse::default() }
    }

    fn all() -> Vec<ParameterResponse> {
        vec![
            parameter("OUT1_TRIM", Value::Integer(-1500)),
            parameter("esc.kp", Value::Real(0.25)),
            parameter("LED", Value::Boolean(true)),
            parameter("NAME", Value::Text(b" left\nwing \\ ".to_vec())),
            parameter("NOTHING", Value::Empty),
            parameter("two words", Value::Integer(1)),
        ]
    }

    /// What is set, and what is wrong, when a file comes to a node that takes every value.
    fn load(file: &str, parameters: &[ParameterResponse]) -> (Vec<(String, Value)>, Vec<String>) {
        let mut loading = Loading::new(file, vec![1, 50]).unwrap();
        loading.begin(parameters);
        let mut set = Vec::new();
        while let Some((name, value)) = loading.next_to_set() {
            assert!(loading.answered(&name, &value));
            set.push((name, value));
        }
        (set, loading.problems())
    }

    #[test]
    fn each_line_has_a_name_and_a_number_and_each_comment_two_words() {
        assert_eq!(
            write("node 42", &all()),
            "# node 42\nOUT1_TRIM -1500\nesc.kp 0.25\nLED 1\n#text NAME  left\\nwing \\\\ \n\
             # not written: two words\n"
        );
    }

    #[test]
    fn a_file_brings_back_what_was_written() {
        let file = write("node 42", &all());
        let mut changed = all();
        changed[0].value = Value::Integer(7);
        changed[1].value = Value::Real(7.0);
        changed[2].value = Value::Boolean(false);
        changed[3].value = Value::Text(b"other".to_vec());
        let (set, problems) = load(&file, &changed);
        let values: Vec<_> = set.into_iter().map(|(_, value)| value).collect();
        let written: Vec<_> = all()[..4].iter().map(|parameter| parameter.value.clone()).collect();
        assert_eq!((values, problems), (written, vec![]));
        assert_eq!(load(&file, &all()), (vec![], vec![]));
    }

    /// As MAVProxy, Mission Planner and the DroneCAN GUI Tool write them, and as people do.
    #[test]
    fn files_of_other_programs_are_read() {
        let (out, led, kp) = ("OUT1_TRIM", "LED", "esc.kp");
        let integer = Value::Integer;
        for (line, name, value) in [
            ("OUT1_TRIM        1444.000000", out, integer(1444)),
            ("OUT1_TRIM,1444", out, integer(1444)),
            ("OUT1_TRIM\t0x5DC # the middle\r", out, integer(1500)),
            ("\n# a comment\n  OUT1_TRIM 1\nOUT1_TRIM 2\n", out, integer(2)),
            ("1\t25\tOUT1_TRIM\t1444\t6", out, integer(1444)),
            ("LED False", led, Value::Boolean(false)),
            ("LED 0.000000", led, Value::Boolean(false)),
            ("esc.kp 1e-3", kp, Value::Real(0.001)),
            ("NAME right wing", "NAME", Value::Text(b"right wing".to_vec())),
        ] {
            assert_eq!(load(line, &all()), (vec![(name.into(), value)], vec![]), "{line}");
        }
    }

    #[test]
    fn what_is_no_value_is_named() {
        for (line, problem) in [
            ("OUT1_TRIM 1500.5", "OUT1_TRIM takes a whole number, not \"1500.5\""),
            ("#text OUT1_TRIM x", "OUT1_TRIM takes a whole number, not \"x\""),
            ("LED 2", "LED takes 1 or 0, not \"2\""),
            ("esc.kp high", "esc.kp takes a number, not \"high\""),
            ("NOTHING 1", "NOTHING takes no value, not \"1\""),
            ("ARMING_CHECK 1", "ARMING_CHECK is no parameter of the node"),
            ("LED 1\nOUT1_TRIM", "line 2 has no value"),
        ] {
            assert_eq!(load(line, &all()), (vec![], vec![problem.into()]), "{line}");
        }
        let many = "A 1\n".repeat(LINES_MAX + 1);
        for file in ["", "# only a comment\n", "\u{7f}ELF", &many] {
            assert!(Loading::new(file, vec![]).is_err(), "{file}");
        }
    }

    /// Two nodes with one ID disturb each other.
    #[test]
    fn the_node_id_of_another_node_is_not_set() {
        let own = [parameter("NODE_ID", Value::Integer(42))];
        let (set, problems) = load("NODE_ID 50", &own);
        assert!(set.is_empty());
        assert_eq!(problems, ["NODE_ID 50 is not set: another node has this ID"]);
        assert_eq!(load("NODE_ID 51", &own).0, [("NODE_ID".into(), Value::Integer(51))]);
    }

    /// RATE is refused while SERVO is 1; LIMIT is above its maximum.
    #[test]
    fn what_a_node_refuses_is_tried_once_more_and_named() {
        let integer = Value::Integer;
        let names = ["RATE", "LIMIT", "SERVO"].map(|name| parameter(name, integer(1)));
        let mut loading = Loading::new("RATE 400\nLIMIT 99\nSERVO 0\n", vec![]).unwrap();
        loading.begin(&names);
        let (mut servo, mut rate) = (1, 1);
        let mut asked = Vec::new();
        while let Some((name, value)) = loading.next_to_set() {
            match (name.as_str(), &value) {
                ("SERVO", Value::Integer(number)) => servo = *number,
                ("RATE", Value::Integer(number)) if servo == 0 => rate = *number,
                _ => {}
            }
            let has = match name.as_str() {
                "SERVO" => servo,
                "RATE" => rate,
                _ => 1,
            };
            assert!(loading.answered(&name, &integer(has)));
            asked.push(name);
        }
        assert_eq!(asked, ["RATE", "LIMIT", "SERVO", "RATE", "LIMIT"]);
        assert_eq!(rate, 400);
        assert_eq!(loading.problems(), ["LIMIT 99 was refused: the node keeps 1"]);
        assert_eq!(loading.summary(), "from the file: 2 set, 0 were so before, 1 NOT");
    }

    #[test]
    fn what_is_left_when_a_node_is_silent_is_named() {
        let names = ["A", "B"].map(|name| parameter(name, Value::Integer(1)));
        let mut loading = Loading::new("A 2\nB 3\n", vec![]).unwrap();
        loading.begin(&names);
        assert_eq!(loading.next_to_set(), Some(("A".into(), Value::Integer(2))));
        assert!(!loading.answered("B", &Value::Integer(3)));
        assert!(loading.answered("A", &Value::Integer(2)));
        loading.abandon();
        assert_eq!(loading.problems(), ["B 3 is not set"]);
        assert_eq!(loading.next_to_set(), None);
    }
}
