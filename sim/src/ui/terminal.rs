//! Whether the terminal can show the live view.

use std::env;

/// True if the terminal moves its cursor and shows colours and the characters of the live view, by
/// the environment: `TERM` is not `dumb`, `NO_COLOR` is empty (no-color.org), and the locale, if
/// one is set, has UTF-8.
pub fn can_show_pictures() -> bool {
    is_capable(|name| env::var(name).ok())
}

/// The same, with `variable` for the environment.
fn is_capable(variable: impl Fn(&str) -> Option<String>) -> bool {
    let set = |name: &str| variable(name).filter(|value| !value.is_empty());
    // The first one that is set decides (POSIX, "Environment Variables").
    let locale = ["LC_ALL", "LC_CTYPE", "LANG"].into_iter().find_map(set);
    let has_utf8 = locale.is_none_or(|locale| {
        let locale = locale.to_ascii_lowercase();
        locale.contains("utf-8") || locale.contains("utf8")
    });
    set("TERM").is_none_or(|term| term != "dumb") && set("NO_COLOR").is_none() && has_utf8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn capable(variables: &[(&str, &str)]) -> bool {
        is_capable(|name| {
            let found = variables.iter().find(|(known, _)| *known == name);
            found.map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn dumb_terminals_and_those_without_colour_or_utf8_get_lines() {
        for variables in [
            &[("TERM", "dumb")][..],
            &[("TERM", "xterm"), ("NO_COLOR", "1")],
            &[("TERM", "xterm"), ("LANG", "C")],
            &[("LANG", "en_US.UTF-8"), ("LC_ALL", "POSIX")],
            &[("LANG", "en_US.UTF-8"), ("LC_CTYPE", "C")],
            &[("LANG", "de_DE.ISO-8859-1")],
        ] {
            assert!(!capable(variables), "{variables:?}");
        }
    }

    #[test]
    fn others_get_the_live_view() {
        for variables in [
            &[][..],
            &[("TERM", "xterm-256color"), ("LANG", "en_US.UTF-8")],
            &[("LANG", "C"), ("LC_ALL", "C.utf8"), ("NO_COLOR", "")],
        ] {
            assert!(capable(variables), "{variables:?}");
        }
    }
}
