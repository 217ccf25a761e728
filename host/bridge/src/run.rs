//! Opens what the options name, and serves it until the program ends.

use crate::args::Args;
use crate::bus::Bus;
use crate::channel::{Channel, Options, byte_rate};
use crate::core::Bridge;
use crate::joined::Joined;
use crate::pty::Pty;
use crate::screen::Screen;
use crate::signing::Signing;
use crate::state::{Rights, Settings};
use anyhow::{Context, Error, Result, anyhow};
use dronecan_host::NodeId;
use dronecan_host::text::visible;
use sha2::{Digest, Sha256};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use std::cell::RefCell;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, SystemTime};

/// Why the program ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    Other,
    Usage,
    Bus,
    Channel,
    Names,
}

/// A bus answers within this time after it was opened.
const OPENS_WITHIN: Duration = Duration::from_secs(3);
/// Time in which every node sends a NodeStatus.
const NODES_SHOW_WITHIN: Duration = Duration::from_millis(2500);
const NAMES_WITHIN: Duration = Duration::from_secs(60);
const AUTOSAVE_AFTER: Duration = Duration::from_secs(2);

/// Runs until the user or `--for` ends it.
///
/// # Errors
/// If something cannot be opened at the start. The bridge reopens what is lost later.
pub fn run(args: &Args) -> Result<(), (Failure, Error)> {
    let other = |error: Error| (Failure::Other, error);
    let ended = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, ended.clone()).map_err(|error| other(error.into()))?;
    }
    let (settings, options) = configure(args).map_err(|error| (Failure::Usage, error))?;
    let bus = Bus::new(args.bus.clone(), args.bitrate, args.mcast_interface);
    let mut line = Joined::new(ended, bus, Bridge::new(settings), options.signing.clone());
    open(&mut line, args, &options)?;
    let mut screen = Screen::open(args).map_err(|error| (Failure::Other, error))?;
    let result = if args.names {
        print_names(&mut line, args)
    } else {
        serve(&mut line, args, &mut screen).map_err(other)
    };
    screen.close();
    line.bus.close();
    result
}

/// The configuration from the options.
fn configure(args: &Args) -> Result<(Settings, Options)> {
    let node = match args.node_id {
        Some(id) => NodeId::new(id),
        None => NodeId::new(args.component),
    };
    let node = node.with_context(|| {
        format!(
            "component {} is not a node ID, which is 1 to 127: give one with --node-id",
            args.component
        )
    })?;
    let epoch = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let settings = Settings {
        system: args.system,
        component: args.component,
        node,
        unique_id: unique_id(args.component),
        info_interval: args.info_interval,
        autosave: args.autosave.then_some(AUTOSAVE_AFTER),
        rights: Rights { change: !args.read_only, can: args.allow_can },
        tunnels: args.tunnel.clone(),
        hidden: args.hide.iter().copied().filter_map(NodeId::new).collect(),
        epoch_us: epoch.as_micros() as u64,
    };
    let options = Options {
        system: args.system,
        versions: args.mavlink_version,
        integers: args.integers,
        // A little less, because a node's clock may be fast.
        status_interval: args
            .status_rate
            .map_or(Duration::ZERO, |rate| Duration::from_secs_f64(0.95 / rate)),
        byte_rate: args.bandwidth.map(byte_rate),
        allowed: args.peer.iter().map(IpAddr::to_canonical).collect(),
        signing: args.signing_key.as_deref().map(|key| signing(args, key)).transpose()?,
    };
    Ok((settings, options))
}

/// A unique ID for this computer: always the same, and it does not identify the computer.
fn unique_id(component: u8) -> [u8; 16] {
    let machine = std::fs::read("/etc/machine-id").unwrap_or_default();
    let mut hash = Sha256::new();
    hash.update(b"dronecan mavlink bridge");
    hash.update([component]);
    hash.update(machine);
    let mut id = [0; 16];
    id.copy_from_slice(&hash.finalize()[..16]);
    id
}

/// The key, and the timestamps that the bridge has accepted before.
fn signing(args: &Args, key: &Path) -> Result<Rc<RefCell<Signing>>> {
    let beside = || {
        let mut path = key.as_os_str().to_owned();
        path.push(".times");
        PathBuf::from(path)
    };
    let path = args.signing_state.clone().unwrap_or_else(beside);
    let signing = Signing::with_file(signing_key(key)?, &path)?;
    Ok(Rc::new(RefCell::new(signing)))
}

/// A file with more bytes is no passphrase.
const LONGEST_KEY: u64 = 4096;

/// The key of a passphrase, as MAVProxy and Mission Planner make it.
fn signing_key(path: &Path) -> Result<[u8; 32]> {
    let text = sim_base::read_text(path, LONGEST_KEY)
        .with_context(|| format!("cannot read the key in {}", path.display()))?;
    let text = text.trim_end_matches(['\r', '\n']);
    if text.is_empty() {
        return Err(anyhow!("{} has no key: write a passphrase into it", path.display()));
    }
    let mut key = [0; 32];
    if text.len() == 2 * key.len() && text.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        for (byte, at) in key.iter_mut().zip((0..text.len()).step_by(2)) {
            *byte = u8::from_str_radix(&text[at..at + 2], 16)?;
        }
    } else {
        key.copy_from_slice(&Sha256::digest(text));
    }
    Ok(key)
}

/// Opens the tunnels, the channels and the bus. With `--wait` the bus may come later.
fn open(line: &mut Joined, args: &Args, options: &Options) -> Result<(), (Failure, Error)> {
    for spec in &args.tunnel {
        let named = |error: Error| {
            (Failure::Channel, error.context(format!("--tunnel {}", spec.path.display())))
        };
        line.ptys.push(Pty::open(&spec.path).map_err(named)?);
        line.bridge.log_line(format!(
            "{} is the serial port of node {}",
            spec.path.display(),
            spec.node
        ));
    }
    for (number, spec) in args.mavlink.iter().enumerate() {
        let now = line.now();
        let channel =
            Channel::open(spec.clone(), number, options.clone(), &mut line.ids, now, args.wait);
        let named = |error: Error| (Failure::Channel, error.context(format!("--mavlink {spec}")));
        line.channels.push(channel.map_err(named)?);
    }
    if args.wait {
        return Ok(());
    }
    let named = |error: Error| (Failure::Bus, error.context(format!("--bus {}", args.bus)));
    line.bus.open(line.now()).map_err(named)?;
    while !line.bus.is_up() && !line.is_ended() {
        line.turn(None);
        if let Some(why) = line.bus.trouble() {
            return Err(named(anyhow!("{why}")));
        }
        if line.now() > OPENS_WITHIN {
            return Err(named(anyhow!("the bus does not answer")));
        }
    }
    Ok(())
}

/// Serves all until a signal, a key or `--for` ends it.
fn serve(line: &mut Joined, args: &Args, screen: &mut Screen) -> Result<()> {
    let end = args.run_for.map(|time| line.now() + time);
    while !line.is_ended() && end.is_none_or(|end| line.now() < end) {
        line.turn(end);
        if screen.show(line)? {
            break;
        }
    }
    screen.last(line);
    Ok(())
}

/// Prints the table of names.
fn print_names(line: &mut Joined, args: &Args) -> Result<(), (Failure, Error)> {
    let failed = |text: &str| (Failure::Names, anyhow!("{text}"));
    let shown = line.now() + NODES_SHOW_WITHIN;
    while line.now() < shown && !line.is_ended() {
        line.turn(Some(shown));
    }
    let now = line.now();
    line.bridge.list_all();
    let end = now + NAMES_WITHIN;
    while line.bridge.is_listing() && line.now() < end && !line.is_ended() {
        line.turn(Some(end));
    }
    let nodes = line.bridge.nodes();
    if nodes.is_empty() {
        return Err(failed("no node has sent a status"));
    }
    println!("{:>4}  {:<16}  {:<6}  {:<20}  name", "node", "in MAVLink", "type", "value");
    let mut all = true;
    for (id, node) in nodes.iter().filter(|(id, _)| !args.hide.contains(&id.get())) {
        let Some(table) = &node.table else {
            eprintln!("bridge: node {id} does not send its parameters");
            all = false;
            continue;
        };
        for entry in &table.entries {
            let kind =
                crate::number::Number::of(&entry.last).map(|number| format!("{:?}", number.kind()));
            let kind = kind.as_deref().and_then(|kind| kind.rsplit('_').next()).unwrap_or("-");
            let value = entry.last.value.to_string();
            let name = entry.last.name();
            let row = format!("{id:>4}  {:<16}  {kind:<6}  {value:<20}  {name}", entry.short);
            println!("{}", visible(&row));
        }
        for parameter in table.left_out.iter().map(|entry| &entry.last) {
            let (value, name) = (parameter.value.to_string(), parameter.name());
            let row = format!("{id:>4}  {:<16}  {:<6}  {value:<20}  {name}", "-", "text");
            println!("{}", visible(&row));
        }
    }
    if all { Ok(()) } else { Err(failed("not all nodes sent their parameters")) }
}
