//! Boots a scene: reads the programs of the command line, powers the boards, and opens the links.

use super::{FLASH_PERIOD, Scene};
use crate::links::script::Script;
use crate::pins::Watched;
use crate::ui::args::Args;
use crate::ui::discharge::Discharge;
use crate::ui::escs::Escs;
use crate::ui::findings::Findings;
use crate::ui::pace::Speed;
use crate::ui::state::{Event, State};
use crate::usage::OrUsage;
use anyhow::{Context, Result, anyhow};
use bench::autopilot::Autopilot;
use bench::avr::{Avr, Firmware, ResetCause};
use bench::board::Board;
use bench::budget::Budget;
use bench::corner::Corner;
use bench::i2c;
use bench::inject::Injector;
use bench::node_ids::{self, CAN_NODE};
use bench::wiring::Wiring;
use bench::{Bench, firmware_like, node_elf};
use std::path::{Path, PathBuf};

impl Scene {
    /// Reads the firmware that `args` names, and powers the boards at time 0.
    ///
    /// # Errors
    /// If the firmware or the bootloader is missing or does not fit, or a link cannot be opened;
    /// the message says what to do.
    pub fn new(args: &Args) -> Result<Scene> {
        // With --no-program the firmware only describes the board, and may be missing.
        let (path, firmware) = match firmware(args) {
            Err(_) if args.links.no_program && args.elf.is_none() => Default::default(),
            found => found?,
        };
        let wiring =
            Wiring::of_program(&firmware).with_context(|| path.display().to_string()).or_usage()?;
        let chip = args.wires.apply(wiring).or_usage()?.chip;
        firmware.check_fits(chip).with_context(|| path.display().to_string()).or_usage()?;
        Scene::boot(&firmware, args)
    }

    /// Powers the boards at time 0 with a firmware that is read already.
    ///
    /// # Errors
    /// If the firmware does not fit the chip, an option does not fit the board, or a link cannot be
    /// opened.
    pub fn boot(firmware: &Firmware, args: &Args) -> Result<Scene> {
        let wiring = args.wires.apply(Wiring::of_program(firmware)?).or_usage()?;
        let loader = args
            .links
            .bootloader
            .as_ref()
            .map(|hex| bootloader(hex.as_deref(), &wiring))
            .transpose()?;
        let (loader, boot_section) = loader.unzip();
        let nothing = Firmware::default();
        let first = if args.links.no_program { &nothing } else { firmware };
        let powered = |program: &Firmware, seed: u64| {
            let mut avr = Avr::programmed_on(args.processor.into(), wiring.chip, program)?;
            avr.seed(seed);
            if let Some(loader) = &loader {
                avr.install_bootloader(loader)?;
            }
            avr.reset(ResetCause::PowerOn);
            avr.watch_stack();
            anyhow::Ok(avr)
        };
        let knows_vendor_code = firmware.board.is_some();
        let limits = knows_vendor_code.then(|| Budget::of(wiring.chip));
        let bit_rate = args.bit_rate(&wiring);
        let circuit_inputs_mv = args.circuit_millivolts(&wiring).or_usage()?;
        let shaft_rpm = args.shaft_rpm(&wiring).or_usage()?;
        let avr = powered(first, 0)?;
        let resets_seen = avr.resets().len();
        let mut bench = Bench::new(bit_rate);
        let corner = args.wires.corner();
        let fitted = |avr: Avr| {
            let mut board = Board::wired(avr, &wiring)?;
            board.set_corner(&corner);
            anyhow::Ok(board)
        };
        let node = bench.add_board(fitted(avr)?, "node");
        // Other projects' programs have their IDs themselves, and so have EEPROMs from files.
        let can_have_ids = knows_vendor_code && args.links.eeprom.is_none();
        let mut have_own_ids = can_have_ids;
        let others = (2..args.links.nodes + 2).map(|number| {
            let seed = number as u64;
            let mut avr = powered(firmware, seed)?;
            let id = node_ids::id_of(number - 2).filter(|_| can_have_ids);
            let saved = id.map(|id| {
                let parameters = [(CAN_NODE, id.into())];
                let bit_rate = bit_rate.min(wiring.fastest_bit_rate());
                node_ids::saved(powered(firmware, seed)?, &wiring, bit_rate, &parameters)
            });
            match saved.transpose()?.flatten() {
                Some(cells) => avr.set_eeprom(&cells),
                None => have_own_ids = false,
            }
            Ok(bench.add_board(fitted(avr)?, &format!("node{number}")))
        });
        let others = others.collect::<Result<Vec<usize>>>()?;
        let autopilot = args.autopilot().or_usage()?.map(|settings| {
            let mut autopilot = Autopilot::new(settings, bit_rate);
            if let Some(deflection) = args.hold {
                autopilot.hold(deflection);
            }
            let port = bench.attach("autopilot", autopilot.station());
            (autopilot, port)
        });
        let injector = Injector::new(&mut bench);
        let boards: Vec<usize> = [node].into_iter().chain(others.iter().copied()).collect();
        let script = args
            .links
            .script
            .as_deref()
            .map(|path| Script::open(path, &mut bench))
            .transpose()
            .or_usage()?;
        for setting in &args.set {
            setting.check(&wiring).or_usage()?;
        }
        let watched: Vec<Watched> =
            args.watch.iter().map(|pin| Watched::attach(*pin, bench.board(node))).collect();
        let links = args.links.open(&mut bench, &boards, boot_section, &args.watch)?;
        let mut injections: Vec<_> = args.inject.clone();
        injections.sort_by_key(|injection| injection.at);

        let mut state = State::new(bit_rate);
        state.memory.flash = first.flash.iter().map(|(_, bytes)| bytes.len() as u32).sum();
        // The bootloader can load another program, so the statics of this one do not count.
        let has_statics = loader.is_none() && firmware.has_statics;
        state.memory.statics = has_statics.then_some(firmware.statics);
        state.memory.limits = limits;
        state.knows_vendor_code = knows_vendor_code;
        state.report(0, Event::Board(format!("{wiring}; bus {} kbit/s", bit_rate / 1000)));
        if corner != Corner::default() {
            state.report(0, Event::Board(format!("corner: {corner}")));
        }
        state.wiring = wiring;
        state.escs = Escs::new(&args.escs);
        let mut scene = Scene {
            node_port: bench.port(node),
            bench,
            node,
            others,
            have_own_ids,
            autopilot,
            replaced: None,
            links,
            script,
            next_status_at: 0,
            application_end: boot_section,
            injector,
            injections: injections.into(),
            state,
            resets_seen,
            jumps_seen: 0,
            unmodelled_seen: 0,
            findings: Findings::new(boot_section),
            next_flash_at: FLASH_PERIOD,
            is_chip_disturbed: false,
            discharge: args.pwr_discharge.map(|minutes| {
                let [full_mv, _] = circuit_inputs_mv;
                Discharge::new(full_mv, minutes)
            }),
            watched,
            i2c: i2c::Devices::default(),
        };
        if !knows_vendor_code {
            scene.findings.watch_selects(scene.bench.board(node));
        }
        scene.set_temperature(args.temperature);
        scene.set_circuit_inputs(circuit_inputs_mv);
        scene.set_shaft(shaft_rpm);
        for setting in &args.set {
            setting.apply(scene.board());
        }
        for setting in &args.i2c {
            scene.i2c.set(setting);
        }
        let devices = scene.i2c.clone();
        scene.board().avr_mut().connect_twi(Box::new(devices));
        for text in scene.watched.iter().map(Watched::text) {
            scene.state.report(0, Event::Pin(text));
        }
        let chip = scene.state.wiring.chip;
        if let Some(own) = first.chip()?.filter(|own| *own != chip) {
            let hint = format!("the program is for an {own}, the board has an {chip}");
            scene.state.add_hint(0, hint);
        }
        scene.collect()?;
        scene.update_links();
        scene.report_links(args);
        Ok(scene)
    }

    fn report_links(&mut self, args: &Args) {
        for line in self.state.links.clone() {
            self.state.report(0, Event::Link(line));
        }
        if self.needs_real_time() && args.speed != Speed::Factor(1.0) {
            let text = "--speed is not 1, but clients use the wall clock: they can time out or \
                        get too many frames";
            self.state.report(0, Event::Link(String::from(text)));
        }
    }
}

/// Reads the bootloader from `hex`, or the one that `make boot` has built for the board. Returns it
/// with the start of its section.
fn bootloader(hex: Option<&Path>, wiring: &Wiring) -> Result<(Firmware, usize)> {
    let path =
        hex.map_or_else(|| bench::bootloader(wiring), |hex| Ok(hex.to_owned())).or_usage()?;
    let loader = Firmware::read_hex(&path).or_usage()?;
    let start = loader.boot_section(wiring.chip).map_err(|error| {
        // Debian's compiler makes it too long for its section.
        let is_optiboot = path.ends_with("optiboot_atmega328.hex");
        let advice = if is_optiboot { "; scripts/optiboot compiles one that fits" } else { "" };
        anyhow!("the bootloader {}: {error:#}{advice}", path.display())
    });
    Ok((loader, start.or_usage()?))
}

/// The program of the command line or of `make`. If it is for another chip or CAN board than
/// `--board` and `--shield` name, the one that `make firmware` has built for those.
fn firmware(args: &Args) -> Result<(PathBuf, Firmware)> {
    let path = args.elf.clone().map_or_else(node_elf, Ok)?;
    let firmware = Firmware::read(&path).or_usage();
    let names_board = args.wires.board.is_some() || args.wires.shield.is_some();
    if args.elf.is_some() || !names_board {
        return Ok((path, firmware?));
    }
    let of = match &firmware {
        Ok(firmware) => Wiring::of_program(firmware)?,
        Err(_) => Wiring::default(),
    };
    let wanted = args.wires.apply(of.clone()).or_usage()?;
    if firmware.is_ok() && (wanted.chip, &wanted.shield) == (of.chip, &of.shield) {
        return Ok((path, firmware?));
    }
    let path = firmware_like(&wanted).or_usage()?;
    let firmware = Firmware::read(&path).or_usage()?;
    Ok((path, firmware))
}
