//! Writes the man pages and the completions for bash, zsh and fish of the programs `sim`, `bridge`,
//! `node-update`, `node-check` and `avr-bounds` below a directory: `manuals ~/.cargo/share`. The
//! shells and `man` look there for a program in `~/.cargo/bin`.

#![forbid(unsafe_code)]

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::{Command, CommandFactory as _};
use clap_complete::Shell;

/// The shells, and where each looks for completions.
const SHELLS: [(Shell, &str); 3] = [
    (Shell::Bash, "bash-completion/completions"),
    (Shell::Zsh, "zsh/site-functions"),
    (Shell::Fish, "fish/vendor_completions.d"),
];

fn main() -> Result<()> {
    let directory = std::env::args_os().nth(1).context("usage: manuals DIRECTORY")?;
    write(&PathBuf::from(directory))
}

/// The commands of the programs.
fn programs() -> [Command; 5] {
    [
        sim::ui::args::Args::command(),
        bridge::args::Args::command(),
        node_tools::update::args::Args::command(),
        node_tools::check::args::Args::command(),
        bounds::command::Args::command(),
    ]
}

fn write(directory: &Path) -> Result<()> {
    let below = |path: &str| -> Result<PathBuf> {
        let path = directory.join(path);
        fs::create_dir_all(&path).with_context(|| format!("cannot make {}", path.display()))?;
        Ok(path)
    };
    for program in programs() {
        let name = program.get_name().to_owned();
        clap_mangen::generate_to(program.clone(), below("man/man1")?)?;
        for (shell, path) in SHELLS {
            let file =
                clap_complete::generate_to(shell, &mut program.clone(), &name, below(path)?)?;
            // bash-completion looks for the name of the program.
            if shell == Shell::Bash {
                fs::rename(&file, file.with_file_name(&name))?;
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process;

    #[test]
    fn each_program_has_a_page_with_all_its_options() {
        let directory = tempfile::tempdir().unwrap();
        write(directory.path()).unwrap();
        for program in programs() {
            let name = program.get_name();
            let page = directory.path().join(format!("man/man1/{name}.1"));
            let page = fs::read_to_string(page).unwrap().replace('\\', "");
            assert!(page.contains(&format!(".TH {name} 1")), "{page}");
            for option in program.get_arguments().filter_map(|option| option.get_long()) {
                assert!(page.contains(&format!("--{option}")), "{name}: {option}");
            }
        }
        assert!(directory.path().join("man/man1/sim-bounds.1").exists());
    }

    /// Loads the file as bash-completion does, and completes a word.
    #[test]
    fn bash_completes_an_option_of_each_program() {
        let directory = tempfile::tempdir().unwrap();
        write(directory.path()).unwrap();
        for (program, word, expected) in [
            ("sim", "--wat", "--watch"),
            ("bridge", "--mavlink-v", "--mavlink-version"),
            ("node-update", "--nod", "--node"),
            ("node-check", "--wat", "--watch"),
            ("avr-bounds", "--stack", "--stack-only"),
        ] {
            let script = format!(
                "source {}/bash-completion/completions/{program}\n\
                 COMP_WORDS=({program} {word}) COMP_CWORD=1\n\
                 set -- $(complete -p {program})\n\
                 while [ $1 != -F ]; do shift; done\n\
                 $2 {program} {word} {program}\n\
                 echo ${{COMPREPLY[*]}}",
                directory.path().display()
            );
            let output = process::Command::new("bash").args(["-c", &script]).output().unwrap();
            let completed = String::from_utf8_lossy(&output.stdout).trim().to_owned();
            assert_eq!(completed, expected, "{}", String::from_utf8_lossy(&output.stderr));
        }
    }
}
