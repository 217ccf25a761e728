//! The `--help` of a program with many options: the common ones on two screens, and the others by
//! topic (`--help TOPIC`). clap has one help for all of them.

use clap::Command;

/// Columns of the help.
const WIDTH: usize = 100;
/// Lines of two screens.
const TWO_SCREENS: usize = 50;

/// A topic: its name, what it is about, the options that belong to it, and a text behind them.
pub struct Topic {
    pub name: &'static str,
    pub about: &'static str,
    /// The IDs of its options, as clap has them.
    pub options: &'static [&'static str],
    pub text: fn() -> String,
}

/// The help of a program.
pub struct Help {
    pub command: fn() -> Command,
    /// What the program does, and its usage.
    pub about: &'static str,
    /// The IDs of the options that `--help` shows.
    pub common: &'static [&'static str],
    pub topics: &'static [Topic],
    /// What the topic `all` is about.
    pub everything: &'static str,
    /// The last lines of `--help` and `--help all`.
    pub end: &'static str,
}

impl Help {
    /// The help that the arguments ask for. `None` if they do not ask, or ask for that of a
    /// subcommand.
    ///
    /// # Errors
    /// If there is no such topic. The text names them.
    pub fn asked(&self, arguments: &[String]) -> Option<Result<String, String>> {
        let command = (self.command)();
        let is_subcommand = |word: &String| {
            command.has_subcommands() && word == "help" || command.find_subcommand(word).is_some()
        };
        if arguments.first().is_some_and(is_subcommand) {
            return None;
        }
        let name = topic_in(arguments)?;
        Some(match self.topics.iter().find(|topic| topic.name == name) {
            _ if name.is_empty() => Ok(self.overview()),
            _ if name == "all" => Ok(self.all()),
            Some(topic) => Ok(self.of(topic)),
            None => {
                let names: Vec<_> = self.topics.iter().map(|topic| topic.name).collect();
                Err(format!("no help about \"{name}\": {} or all", names.join(", ")))
            }
        })
    }

    fn overview(&self) -> String {
        let topics = self.topics.iter().map(|topic| (topic.name, topic.about));
        format!(
            "{}\n{}\nMore with --help TOPIC:\n{}\n{}",
            self.about,
            self.options(|id| self.common.contains(&id), false),
            table(topics.chain([("all", self.everything)])),
            self.end,
        )
    }

    fn all(&self) -> String {
        let topics: Vec<String> = self
            .topics
            .iter()
            .map(|topic| {
                // All of them would have the heading "Options:".
                let text = self.of(topic);
                let options = text.strip_prefix("Options:");
                options.map_or(text.clone(), |rest| format!("Options, {}:{rest}", topic.about))
            })
            .collect();
        format!("{}\n{}\n{}", self.about, topics.join("\n"), self.end)
    }

    fn of(&self, topic: &Topic) -> String {
        let text = (topic.text)();
        if topic.options.is_empty() {
            return text;
        }
        let options = self.options(|id| topic.options.contains(&id), true);
        let gap = if text.is_empty() { "" } else { "\n" };
        format!("{options}{gap}{text}")
    }

    /// The options with these IDs, with the first paragraph of their texts or with all of it.
    fn options(&self, is_shown: impl Fn(&str) -> bool, is_long: bool) -> String {
        let mut command = (self.command)()
            .help_template("{all-args}")
            .disable_help_flag(true)
            .disable_help_subcommand(true)
            .disable_version_flag(true)
            .after_help("")
            .after_long_help("")
            .mut_args(|arg| {
                let is_hidden = arg.is_hide_set() || !is_shown(arg.get_id().as_str());
                arg.hide(is_hidden)
            })
            .mut_subcommands(|command| command.hide(true));
        let text = if is_long { command.render_long_help() } else { command.render_help() };
        wrapped(&text.to_string())
    }

    /// For the tests of a program.
    ///
    /// # Panics
    /// If `--help` does not fit two screens or does not name each topic, or if an option belongs to
    /// no topic or to several.
    #[track_caller]
    pub fn assert_is_whole(&self) {
        let text = self.overview();
        assert!(text.lines().count() <= TWO_SCREENS, "{} lines:\n{text}", text.lines().count());
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH), "{text}");
        for topic in self.topics {
            assert!(text.contains(&table([(topic.name, topic.about)])), "{}", topic.name);
        }
        for arg in (self.command)().get_arguments().filter(|arg| !arg.is_hide_set()) {
            let id = arg.get_id().as_str();
            let topics = self.topics.iter().filter(|topic| topic.options.contains(&id)).count();
            assert_eq!(topics, 1, "{id}");
        }
    }
}

/// Breaks the lines at [`WIDTH`] columns, and indents what follows as the text of the line.
fn wrapped(text: &str) -> String {
    let mut out = String::new();
    for line in text.lines() {
        let name = line.trim_start();
        let before = line.len() - name.len();
        // The text begins behind the name and two spaces; without a name, behind the indentation.
        let indent = match name.find("  ").filter(|_| name.starts_with('-')) {
            Some(at) => before + at + name[at..].len() - name[at..].trim_start().len(),
            None => before,
        };
        let (mut left, mut is_first) = (line, true);
        loop {
            let margin = if is_first { 0 } else { indent };
            let end = match left.char_indices().nth(WIDTH - margin) {
                Some((limit, _)) => left[..limit].rfind(' ').filter(|at| *at > indent),
                None => None,
            };
            out += &" ".repeat(margin);
            match end {
                Some(end) => {
                    out += &left[..end];
                    left = left[end..].trim_start();
                    is_first = false;
                    out.push('\n');
                }
                None => break,
            }
        }
        out += left.trim_end();
        out.push('\n');
    }
    out
}

/// Aligns names and texts.
fn table(rows: impl IntoIterator<Item = (&'static str, &'static str)>) -> String {
    rows.into_iter().map(|(name, text)| format!("  {name:11}{text}\n")).collect()
}

/// The topic that the arguments ask for, and an empty one for `--help` alone. `None` if they do not
/// ask.
fn topic_in(arguments: &[String]) -> Option<&str> {
    let at = arguments
        .iter()
        .position(|word| matches!(&**word, "-h" | "--help") || word.starts_with("--help="))?;
    match arguments[at].strip_prefix("--help=") {
        Some(topic) => Some(topic),
        None => arguments
            .get(at + 1)
            .map(String::as_str)
            .filter(|next| !next.starts_with('-'))
            .or(Some("")),
    }
}
