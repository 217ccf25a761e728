//! What the analysis assumes of a program and does not check, with the places where it does.

use serde::Serialize;

use crate::program::{Address, Program};
use crate::stack::Analysis;

/// Something that must be true, or the figures are not.
#[derive(Debug, Clone, Serialize)]
pub struct Assumption {
    /// What.
    pub text: String,
    /// The instructions of which it is assumed.
    pub places: Vec<String>,
}

/// All that is assumed of a program whose stack and times were found. `annotated` has what the
/// annotations of loops and waits say, by the first instruction of the loop.
pub fn assumptions<'a>(
    analysis: &Analysis<'_>,
    annotated: impl Iterator<Item = (&'a u32, &'a String)>,
) -> Vec<Assumption> {
    let program = analysis.program;
    let assumed = &analysis.assumed;
    let mut all: Vec<Assumption> = Vec::new();
    let mut add = |text: &str, places: &mut dyn Iterator<Item = u32>| {
        let places: Vec<String> = places.map(|at| place(program, at)).collect();
        match all.iter_mut().find(|known: &&mut Assumption| known.text == text) {
            Some(known) => known.places.extend(places),
            None if places.is_empty() => {}
            None => all.push(Assumption { text: text.into(), places }),
        }
    };
    if program.entry != 0 {
        let text = "the fuses let the chip begin here";
        add(text, &mut std::iter::once(program.entry));
    }
    add(
        "a store through a pointer changes variables only, and no register of the core or of the \
         interrupts, no return address and no saved register",
        &mut assumed.stores.iter().copied(),
    );
    add(
        "SPM changes no code or constant of this program, and does not halt the core",
        &mut assumed.spm.iter().copied(),
    );
    add("BREAK does nothing: there is no debugger", &mut assumed.breaks.iter().copied());
    add(
        "a virtual call leads to a function of one of the program's tables of virtual functions",
        &mut assumed.virtual_calls.iter().copied(),
    );
    for at in &assumed.indirect {
        let function = program.function_name(*at);
        let named = analysis.annotations.indirect.iter().find(|entry| entry.function == function);
        let reason = named.map_or("", |entry| entry.reason.trim());
        let text = format!("the annotation names all targets: {}", line(reason));
        add(&text, &mut std::iter::once(*at));
    }
    for (head, text) in annotated {
        add(&format!("the annotation is true: {}", line(text)), &mut std::iter::once(*head));
    }
    all
}

/// A reason in one line.
fn line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<&str>>().join(" ")
}

fn place(program: &Program, at: u32) -> String {
    if at == program.entry { Address(at).to_string() } else { program.place(at) }
}
