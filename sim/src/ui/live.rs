//! Draws the live view from the state of the bench and the state of the screen. It changes neither.
//!
//! The layout fits 80 columns by 24 rows. On a higher terminal it adds a dial for the servo. On a
//! wider one it puts the serial monitor beside the traffic.

use super::escs::Throttle;
use super::keys;
use super::pace::Measured;
use super::popups;
use super::screen::Screen;
use super::state::{AutopilotState, State, error_state_name};
use super::styles::{BAD, DIM, GOOD, NODE, WARN};
use super::traffic::{Origin, TrafficLine};
use crate::fault::Fault;
use crate::time::{micros, seconds};
use bench::Cycles;
use bench::can::ErrorState;
use bench::dronecan::broadcast::hardpoint_text;
use bench::dronecan::{Dialect, Health, Rpm};
use bench::thousands;
use bench::vendor_code;
use bench::wiring::Wiring;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Style, Stylize};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::canvas::{Canvas, Circle, Context, Line as Stroke, Points};
use ratatui::widgets::{Block, Paragraph};

/// Smallest terminal on which the live view is drawn.
pub const COLUMNS_MIN: u16 = 80;
pub const ROWS_MIN: u16 = 24;

const READINGS_ROWS: u16 = 6;
const DIAL_ROWS: u16 = 16;
/// Smallest height with room for the dial and for a useful number of lines of traffic.
const DIAL_FROM_ROWS: u16 = 40;
const BUS_ROWS: u16 = 4;
/// Lines for the conditions of the vendor-specific status code, at most.
const CONDITION_ROWS: usize = 2;
/// Lines for a hint, at most.
const HINT_ROWS: usize = 3;
/// Lines for the faults that are on, at most.
const FAULT_ROWS: usize = 2;
/// Lines for a crash, and for the first mistake, at most.
const FAILURE_ROWS: usize = 2;
/// Columns of an output after the first, and of its scale: four outputs on 80 columns.
const OUTPUT_COLUMNS: usize = 20;
const OUTPUT_TRACK: usize = 8;
/// Lines for the links, at most, on a small and on a larger terminal.
const LINK_ROWS_SMALL: u16 = 3;
const LINK_ROWS: u16 = 12;
const SIDE_BY_SIDE_FROM_COLUMNS: u16 = 140;
/// Wide enough for the longest line that the node prints for a command.
const SERIAL_COLUMNS: u16 = 74;

/// The servo picture spans this pulse range, in microseconds; 1500 is the middle.
const SERVO_MIN_US: f64 = 500.0;
const SERVO_MAX_US: f64 = 2500.0;
/// Angle of a standard servo for a pulse: 180 degrees over the range above.
const DEGREES_PER_US: f64 = 180.0 / (SERVO_MAX_US - SERVO_MIN_US);

/// Draws the live view. Returns the number of lines of traffic on it, which is a page for
/// scrolling.
pub fn draw(frame: &mut Frame<'_>, state: &State, screen: &Screen) -> usize {
    let area = frame.area();
    if area.width < COLUMNS_MIN || area.height < ROWS_MIN {
        let text = format!("sim needs a terminal of {COLUMNS_MIN}x{ROWS_MIN}: please enlarge it");
        frame.render_widget(Paragraph::new(text), area);
        return 0;
    }
    let with_dial = area.height >= DIAL_FROM_ROWS;
    let measured_rows = measured_lines(state).len() as u16;
    let top_rows = if with_dial { DIAL_ROWS } else { READINGS_ROWS + measured_rows + BUS_ROWS };
    let columns = usize::from(area.width);
    let mut note_lines = output_lines(state, columns);
    note_lines.extend(failure_lines(state, columns));
    note_lines.extend(hint_lines(state, screen, columns));
    note_lines.extend(condition_lines(state, columns));
    note_lines.extend(fault_lines(state, columns));
    let note_rows = note_lines.len() as u16;
    // On a small terminal the notes take lines from the links, so that the lists keep a useful
    // length.
    let link_rows_max = if with_dial {
        LINK_ROWS
    } else {
        LINK_ROWS_SMALL.saturating_sub(note_rows.saturating_sub(1)).max(1)
    };
    let link_rows = u16::try_from(state.links.len()).unwrap_or(u16::MAX).min(link_rows_max);
    let [title, top, notes, links, lists, foot] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(top_rows),
        Constraint::Length(note_rows),
        Constraint::Length(link_rows),
        Constraint::Min(0),
        Constraint::Length(1),
    ])
    .areas(area);
    frame.render_widget(title_line(state, screen), title);
    let halves = |area| Layout::horizontal([Constraint::Percentage(50); 2]).areas(area);
    let [servo, node, bus, controller] = if with_dial {
        let [left, right] = halves(top);
        let rows = [Constraint::Min(0), Constraint::Length(BUS_ROWS), Constraint::Length(BUS_ROWS)];
        let [node, bus, controller] = Layout::vertical(rows).areas(right);
        [left, node, bus, controller]
    } else {
        let rows = [Constraint::Min(0), Constraint::Length(BUS_ROWS)];
        let [upper, lower] = Layout::vertical(rows).areas(top);
        let ([servo, node], [bus, controller]) = (halves(upper), halves(lower));
        [servo, node, bus, controller]
    };
    draw_servo(frame, servo, state, with_dial);
    draw_node(frame, node, state);
    draw_bus(frame, bus, state);
    draw_controller(frame, controller, state);
    frame.render_widget(Paragraph::new(note_lines), notes);
    frame.render_widget(link_lines(state, usize::from(link_rows)), links);
    let [traffic, serial] = if area.width >= SIDE_BY_SIDE_FROM_COLUMNS {
        Layout::horizontal([Constraint::Min(0), Constraint::Length(SERIAL_COLUMNS)]).areas(lists)
    } else {
        Layout::vertical([Constraint::Percentage(58), Constraint::Percentage(42)]).areas(lists)
    };
    if screen.shows_load {
        draw_load(frame, traffic, state);
    } else {
        draw_traffic(frame, traffic, state, screen);
    }
    draw_serial(frame, serial, state);
    frame.render_widget(foot_line(foot.width), foot);
    popups::draw(frame, area, state, screen);
    usize::from(traffic.height.saturating_sub(2))
}

fn title_line(state: &State, screen: &Screen) -> Line<'static> {
    let Measured { factor, capacity } = screen.speed;
    let mut spans = vec![
        Span::from(format!(" {:.3} s ", seconds(state.now))).bold(),
        Span::from(format!("speed {factor:.2} (max {capacity:.1})  ")),
    ];
    if screen.is_paused {
        spans.push(Span::styled(" PAUSED ", WARN.reversed()));
    }
    let Some(autopilot) = &state.autopilot else {
        spans.push(Span::from(" no autopilot"));
        return Line::from(spans);
    };
    let motion = if autopilot.is_sweeping { "sweeps" } else { "holds" };
    let AutopilotState { node_id, deflection, profile, command_type, .. } = autopilot;
    let amount = match (autopilot.moves_all, autopilot.is_sweeping) {
        // Each actuator has its own deflection.
        (true, true) => String::from("all"),
        (true, false) => format!("all {deflection:+.2}"),
        (false, _) => format!("{deflection:+.2}"),
    };
    let motors =
        if autopilot.motors > 0 { format!(", {} motors", autopilot.motors) } else { String::new() };
    let dialect = dialect_note(autopilot.dialect);
    spans.push(if autopilot.is_silent {
        Span::styled(format!(" {profile} {node_id}{dialect} is silent"), WARN)
    } else {
        Span::from(format!(
            " {profile} {node_id}{dialect} {motion} {amount} {command_type}{motors}"
        ))
    });
    if !autopilot.is_armed {
        spans.push(Span::styled("  disarmed", WARN));
    }
    Line::from(spans)
}

/// Note on the dialect for a title. The current dialect, v0, has none.
fn dialect_note(dialect: Dialect) -> &'static str {
    match dialect {
        Dialect::V0 => "",
        Dialect::Draft => " (draft)",
    }
}

/// The crash, and the first driver mistake with the number of all.
fn failure_lines(state: &State, columns: usize) -> Vec<Line<'static>> {
    let lines = |lead: String, text: &str| {
        let words = text.split(' ').map(|word| Line::styled(format!(" {word}"), BAD)).collect();
        wrapped(Line::styled(format!(" {lead}:"), BAD.reversed()), words, columns, FAILURE_ROWS)
    };
    let crash = state.crash.iter().flat_map(|text| lines(String::from("CRASHED"), text));
    let mistake = state.mistakes.kinds().first().map(|first| {
        let count = state.mistakes.total();
        let plural = if count == 1 { "" } else { "S" };
        let at = seconds(first.first_at);
        lines(format!("{count} DRIVER MISTAKE{plural}, first at {at:.4} s"), &first.text)
    });
    crash.chain(mistake.into_iter().flatten()).collect()
}

/// The oldest hint that was not acknowledged, and the number of the others.
fn hint_lines(state: &State, screen: &Screen, columns: usize) -> Vec<Line<'static>> {
    let mut waiting = state.notices().skip(screen.acknowledged);
    let Some(hint) = waiting.next() else { return Vec::new() };
    let more = match waiting.count() {
        0 => String::new(),
        count => format!(", {count} more"),
    };
    let words = hint.split(' ').map(|word| Line::styled(format!(" {word}"), WARN)).collect();
    let lead = Line::styled(format!(" HINT (k: seen{more}):"), WARN.reversed());
    wrapped(lead, words, columns, HINT_ROWS)
}

/// The conditions in the vendor-specific status code, if the program is this project's.
fn condition_lines(state: &State, columns: usize) -> Vec<Line<'static>> {
    let Some((_, node, status)) = state.status.filter(|_| state.knows_vendor_code) else {
        return Vec::new();
    };
    let conditions = vendor_code::conditions(status.vendor_code);
    let last = conditions.len().saturating_sub(1);
    let texts = conditions.iter().enumerate().map(|(index, text)| {
        let comma = if index < last { "," } else { "" };
        Line::from(Span::styled(format!(" {text}{comma}"), WARN))
    });
    let lead = Line::from(format!(" Node {node} says {:#06X}:", status.vendor_code));
    wrapped(lead, texts.collect(), columns, CONDITION_ROWS)
}

/// The faults that are on, each with the key that ends it.
fn fault_lines(state: &State, columns: usize) -> Vec<Line<'static>> {
    let text = |fault: &Fault| {
        let key = keys::key_of(*fault).map_or(String::new(), |key| format!(" {key}"));
        Line::from(vec![
            Span::from(" "),
            Span::styled(key, BAD.reversed()),
            Span::styled(format!(" {fault} "), BAD.reversed()),
        ])
    };
    let faults = state.active_faults.iter().map(text).collect();
    wrapped(Line::from(" Faults on (x ends all):"), faults, columns, FAULT_ROWS)
}

/// Puts `lead` and `items` on at most `rows` lines of `columns` columns, and counts the items that
/// do not fit. Without items there are no lines.
fn wrapped(
    lead: Line<'static>,
    items: Vec<Line<'static>>,
    columns: usize,
    rows: usize,
) -> Vec<Line<'static>> {
    const MORE: &str = " and 99 more";
    if items.is_empty() {
        return Vec::new();
    }
    let mut left = items.len();
    let mut lines = vec![lead];
    for item in items {
        let is_last_line = lines.len() == rows;
        let line = lines.last_mut().expect("lines begins with lead");
        let reserve = if is_last_line && left > 1 { MORE.len() } else { 0 };
        if line.width() + item.width() + reserve <= columns {
            line.extend(item);
        } else if is_last_line {
            line.push_span(Span::styled(format!(" and {left} more"), DIM));
            break;
        } else {
            lines.push(item);
        }
        left -= 1;
    }
    lines
}

/// The links, a line each, and the number of links that do not fit on `rows` lines.
fn link_lines(state: &State, rows: usize) -> Paragraph<'static> {
    let mut lines: Vec<_> =
        state.links.iter().take(rows).map(|link| Line::from(format!(" {link}"))).collect();
    let hidden = state.links.len() - lines.len();
    if hidden > 0 {
        lines.pop();
        lines.push(Line::styled(format!(" and {} more", hidden + 1), DIM));
    }
    Paragraph::new(lines)
}

/// Output 2 and the further outputs, as long as one of them gives pulses: name, scale and pulse
/// width of each, of a motor its throttle in per cent.
fn output_lines(state: &State, columns: usize) -> Vec<Line<'static>> {
    let cell = |(number, width): (usize, Option<Cycles>)| {
        let mut spans = vec![Span::from(format!(" OUT{number} "))];
        if let Some(throttle) = width.and_then(|width| state.throttle_of(number, width)) {
            spans.extend(throttle_bar(OUTPUT_TRACK, throttle));
            spans.push(Span::from(format!(" {:>3.0}% ", throttle.percent)));
            return spans;
        }
        let us = width.map(micros);
        let width = us.map_or(String::from("-"), |us| format!("{us:.0}"));
        spans.extend(track(OUTPUT_TRACK, us));
        spans.push(Span::from(format!(" {width:>4} ")));
        spans
    };
    let cells: Vec<Vec<Span<'_>>> = (2..).zip(state.output_widths()).map(cell).collect();
    let in_a_line = (columns / OUTPUT_COLUMNS).max(1);
    cells.chunks(in_a_line).map(|cells| Line::from(cells.concat())).collect()
}

/// A line for each measurement that only some programs send: of a circuit, a battery, relays, a
/// shaft.
fn measured_lines(state: &State) -> Vec<Line<'static>> {
    let lines = [circuit_line, battery_line, hardpoint_line, shaft_line];
    lines.into_iter().filter_map(|line| line(state)).collect()
}

/// The last CircuitStatus of the node; `None` before the first.
fn circuit_line(state: &State) -> Option<Line<'static>> {
    let circuit = state.measured.circuit?;
    let [voltage, current] =
        [(circuit.voltage, "V"), (circuit.current, "A")].map(|(value, unit)| {
            if value.is_nan() {
                format!("- {unit}")
            } else {
                format!("{:.2} {unit}", value.to_f32())
            }
        });
    let errors = Span::styled(circuit.errors_text(), BAD);
    Some(Line::from(vec![Span::from(format!("circuit {voltage}  {current}")), errors]))
}

/// The last BatteryInfo of the node; `None` before the first. Voltage and current are here only if
/// no CircuitStatus has them.
fn battery_line(state: &State) -> Option<Line<'static>> {
    let battery = state.measured.battery.as_ref()?;
    let mut text = format!("battery {}", battery.battery);
    if state.measured.circuit.is_none() {
        let (volts, amperes) = (battery.voltage.to_f32(), battery.current.to_f32());
        text += &format!(" {volts:.2} V {amperes:.2} A");
    }
    let flags = Span::styled(battery.flags_text(), BAD);
    Some(Line::from(vec![Span::from(text + &battery.charge_text()), flags]))
}

/// The node's relays, with the last hardpoint.Status of each; `None` before the first.
fn hardpoint_line(state: &State) -> Option<Line<'static>> {
    let texts: Vec<String> = state
        .measured
        .hardpoints
        .iter()
        .map(|(id, &status)| format!("{id} {}", hardpoint_text(status)))
        .collect();
    (!texts.is_empty()).then(|| Line::from(format!("hardpoint {}", texts.join(", "))))
}

/// The speed of the shaft, and the last one that the node sent; `None` for a program that counts no
/// pulses.
fn shaft_line(state: &State) -> Option<Line<'static>> {
    let pin = state.wiring.rpm?;
    let sent = match state.measured.rpm {
        Some(rpm) if rpm.flags & Rpm::UNHEALTHY != 0 => Span::styled("node UNHEALTHY", BAD),
        Some(rpm) => Span::from(format!("node {} rpm", rpm.speed_text())),
        None => Span::from("node sends none (RPM_RATE)"),
    };
    Some(Line::from(vec![Span::from(format!("shaft ({pin}) {} rpm  ", state.shaft_rpm)), sent]))
}

fn draw_servo(frame: &mut Frame<'_>, area: Rect, state: &State, with_dial: bool) {
    let Wiring { servo, sensor, .. } = &state.wiring;
    let throttle = state.throttle();
    let is_motor = state.is_motor();
    let name = match (state.output_widths().is_empty(), is_motor) {
        (true, false) => "Servo",
        (true, true) => "Motor",
        (false, _) => "OUT1",
    };
    let block = Block::bordered().title(format!(" {name} ({servo}) and temperature ({sensor}) "));
    let inner = block.inner(area);
    frame.render_widget(block, area);
    let pulse_us = state.servo.pulse.map(micros);
    let pulse = match &state.servo.words()[..] {
        [width, period @ ..] => {
            let period = period.iter().map(|period| Span::from(format!("  {period}")));
            Line::from_iter([Span::from(width.clone()).bold()].into_iter().chain(period))
        }
        [] if is_motor => Line::styled("no pulse: the motor is off", WARN),
        [] => Line::styled("no pulse: the servo is free", WARN),
    };
    let position = match throttle {
        Some(Throttle { percent, is_oneshot125: true }) => {
            format!("throttle {percent:.1} % (OneShot125)")
        }
        Some(Throttle { percent, .. }) => format!("throttle {percent:.1} %"),
        None if is_motor => String::from("throttle -"),
        None => {
            let us = pulse_us.map(|us| format!("{:+.1} deg", angle_degrees(us)));
            format!("angle {}", us.unwrap_or(String::from("-")))
        }
    };
    let measured = match (state.measured.temperature, state.measured.thesis_temperature_c) {
        (Some(measured), Some(thesis)) => format!("node {:.1} C, {thesis} C", measured.celsius()),
        (Some(measured), None) => format!("node {:.1} C", measured.celsius()),
        (None, Some(thesis)) => format!("node {thesis} C"),
        (None, None) => match state.measured.draft_measurement {
            Some(number) => format!("node sends {number}"),
            None => String::from("node sends none"),
        },
    };
    let mut lines = vec![
        pulse,
        match throttle {
            Some(throttle) => motor_bar(inner.width, throttle),
            None => servo_bar(inner.width, pulse_us),
        },
        match state.light_percent {
            0 => Line::from(format!("{position}  pulses {}", state.servo.count)),
            percent => {
                let pin = state.wiring.light.map_or(String::new(), |pin| format!("({pin}) "));
                Line::from(format!("{position}  light {pin}{percent} %"))
            }
        },
        if state.pins.is_empty() {
            Line::from(format!("sensor {:.1} C  {measured}", state.sensor_c))
        } else {
            Line::from(format!("pins {}", state.pins.join("  ")))
        },
    ];
    if !with_dial || is_motor {
        return frame.render_widget(Paragraph::new(lines), inner);
    }
    lines.remove(1);
    let [dial, text] =
        Layout::vertical([Constraint::Min(0), Constraint::Length(lines.len() as u16)]).areas(inner);
    frame.render_widget(Paragraph::new(lines), text);
    draw_dial(
        frame,
        dial,
        pulse_us,
        state.autopilot.as_ref().map(|autopilot| autopilot.deflection),
    );
}

fn angle_degrees(pulse_us: f64) -> f64 {
    (pulse_us - (SERVO_MIN_US + SERVO_MAX_US) / 2.0) * DEGREES_PER_US
}

/// The pulse width on a scale: "500 |------+---#---| 2500".
fn servo_bar(width: u16, pulse_us: Option<f64>) -> Line<'static> {
    let mut spans = vec![Span::styled(format!("{SERVO_MIN_US:4.0} "), DIM)];
    spans.extend(track(usize::from(width).saturating_sub(12).max(3), pulse_us));
    spans.push(Span::styled(format!(" {SERVO_MAX_US:4.0}"), DIM));
    Line::from(spans)
}

/// The pulse width on a scale of `length` columns: "|------+---#---|".
fn track(length: usize, pulse_us: Option<f64>) -> Vec<Span<'static>> {
    let mut cells = vec!['─'; length];
    cells[0] = '├';
    cells[length - 1] = '┤';
    cells[length / 2] = '┼';
    let Some(pulse_us) = pulse_us else {
        return vec![Span::styled(cells.iter().collect::<String>(), DIM)];
    };
    let share = (pulse_us - SERVO_MIN_US) / (SERVO_MAX_US - SERVO_MIN_US);
    let place = (share.clamp(0.0, 1.0) * (length - 1) as f64).round() as usize;
    vec![
        Span::from(cells[..place].iter().collect::<String>()),
        Span::styled("█", NODE),
        Span::from(cells[place + 1..].iter().collect::<String>()),
    ]
}

/// The throttle on a scale: "0 |####------| 100 %".
fn motor_bar(width: u16, throttle: Throttle) -> Line<'static> {
    let mut spans = vec![Span::styled("   0 ", DIM)];
    spans.extend(throttle_bar(usize::from(width).saturating_sub(12).max(3), throttle));
    spans.push(Span::styled(" 100 %", DIM));
    Line::from(spans)
}

/// The throttle as the filled part of `length` columns.
fn throttle_bar(length: usize, throttle: Throttle) -> Vec<Span<'static>> {
    let filled = (throttle.percent / 100.0 * length as f64).round() as usize;
    vec![
        Span::styled("█".repeat(filled), NODE),
        Span::styled("─".repeat(length - filled.min(length)), DIM),
    ]
}

/// Draws a half dial, 0 degrees up, with the servo's horn, and a mark outside for the commanded
/// deflection.
fn draw_dial(frame: &mut Frame<'_>, area: Rect, pulse_us: Option<f64>, deflection: Option<f64>) {
    // A character cell is about twice as high as wide; the bounds keep the dial round.
    let (bottom, top) = (-0.12, 1.25);
    let cells = f64::from(area.width) / (2.0 * f64::from(area.height.max(1)));
    let half_width = cells * (top - bottom) / 2.0;
    let on_circle = |degrees: f64, radius: f64| {
        let angle = degrees.to_radians();
        (radius * angle.sin(), radius * angle.cos())
    };
    let stroke =
        |from: (f64, f64), to: (f64, f64), color| Stroke::new(from.0, from.1, to.0, to.1, color);
    let paint = |context: &mut Context<'_>| {
        let arc: Vec<_> = (-90..=90).map(|d| on_circle(f64::from(d), 1.0)).collect();
        context.draw(&Points { coords: &arc, color: Color::DarkGray });
        for degrees in (-90..=90).step_by(45) {
            let degrees = f64::from(degrees);
            context.draw(&stroke(on_circle(degrees, 0.92), on_circle(degrees, 1.0), Color::Gray));
        }
        context.draw(&Circle { x: 0.0, y: 0.0, radius: 0.08, color: Color::Gray });
        if let Some(deflection) = deflection {
            // +-1 commands +-500 us, 45 degrees.
            let (x, y) = on_circle(deflection * 45.0, 1.1);
            context.draw(&Circle { x, y, radius: 0.03, color: Color::Yellow });
        }
        if let Some(pulse_us) = pulse_us {
            let degrees = angle_degrees(pulse_us).clamp(-100.0, 100.0);
            context.layer();
            for offset in [-1.5, 0.0, 1.5] {
                let tip = on_circle(degrees, 0.88);
                context.draw(&stroke(on_circle(degrees + 60.0 * offset, 0.06), tip, Color::Cyan));
            }
        }
    };
    let canvas = Canvas::default()
        .marker(Marker::Braille)
        .x_bounds([-half_width, half_width])
        .y_bounds([bottom, top])
        .paint(paint);
    frame.render_widget(canvas, area);
}

fn draw_node(frame: &mut Frame<'_>, area: Rect, state: &State) {
    let title = match state.status {
        Some((_, id, _)) => format!("Node {id}{}", dialect_note(state.dialect)),
        None => String::from("Node"),
    };
    let title = format!(" {title} on {} ", state.wiring.board_name());
    let with_chip = format!("{title}({}) ", state.wiring.chip);
    let title = if with_chip.len() + 2 <= usize::from(area.width) { with_chip } else { title };
    let mut lines = match state.status {
        Some((at, _, status)) => {
            let style = match status.health {
                Health::Ok => GOOD,
                Health::Warning => WARN,
                Health::Error | Health::Critical => BAD,
            };
            let age = seconds(state.now.saturating_sub(at));
            let first = match state.silent_for() {
                Some(_) => vec![Span::styled(format!("SILENT for {age:.1} s"), BAD)],
                None => vec![
                    Span::styled(status.health.to_string(), style),
                    Span::from(format!(" {}  uptime {} s", status.mode, status.uptime_s)),
                ],
            };
            let code = format!("{:#06X}", status.vendor_code);
            let second = match state.silent_for() {
                Some(_) => format!("before: {} {} {code}", status.health, status.mode),
                None => format!("vendor code {code}  heard {age:.1} s ago"),
            };
            vec![Line::from(first), Line::from(second)]
        }
        None => vec![Line::styled("no NodeStatus yet", WARN), Line::default()],
    };
    if state.crash.is_some() {
        lines[0] = Line::styled("CRASHED", BAD);
    }
    let memory = &state.memory;
    let limit = memory.limit(|limits| limits.flash);
    let (text, style) = amount("flash ", memory.flash, limit, " of ");
    lines.push(Line::styled(format!("{text} B"), style));
    if let Some(statics) = memory.statics {
        let limit = memory.limit(|limits| limits.statics);
        let (text, style) = amount("statics ", statics, limit, "/");
        let mut line = Line::styled(text, style);
        if let Some(stack) = memory.stack {
            let limit = memory.limit(|limits| limits.statics_and_stack);
            let (text, style) = amount(", RAM ", statics + stack, limit, "/");
            line.push_span(Span::styled(text, style));
        }
        line.push_span(Span::from(" B"));
        lines.push(line);
    }
    lines.extend(measured_lines(state));
    let block = Block::bordered().title(title);
    frame.render_widget(Paragraph::new(lines).block(block), area);
}

/// The used bytes of a memory, and after `of` their limit if there is one. The style marks a use
/// above the limit.
fn amount(name: &str, used: u32, limit: Option<u32>, of: &str) -> (String, Style) {
    let of = limit.map_or(String::new(), |limit| format!("{of}{}", thousands(limit as usize)));
    let style = if limit.is_some_and(|limit| used > limit) { BAD } else { Style::new() };
    (format!("{name}{}{of}", thousands(used as usize)), style)
}

fn draw_bus(frame: &mut Frame<'_>, area: Rect, state: &State) {
    let bus = &state.bus;
    let count = |number: u64| if number == 0 { Style::new() } else { WARN };
    let lines = vec![
        Line::from(format!(
            "load {:.1} %  {} frames/s  all {}",
            bus.load_percent(state.now),
            bus.frames_per_second(),
            bus.frames
        )),
        Line::from(vec![
            Span::styled(format!("error frames {}", bus.error_frames), count(bus.error_frames)),
            Span::styled(format!("  no ACK {}", bus.unacknowledged), count(bus.unacknowledged)),
        ]),
    ];
    let block = Block::bordered().title(format!(" Bus {} kbit/s ", bus.bit_rate / 1000));
    frame.render_widget(Paragraph::new(lines).block(block), area);
}

fn draw_controller(frame: &mut Frame<'_>, area: Rect, state: &State) {
    let controller = &state.controller;
    let style = match controller.error_state {
        ErrorState::Active => Style::new(),
        ErrorState::Passive => WARN,
        ErrorState::BusOff => BAD,
    };
    let lost_style = if controller.overflows == 0 { Style::new() } else { BAD };
    let us = |time: Option<u64>| time.map_or(String::from("-"), |t| format!("{:.0}", micros(t)));
    let lines = vec![
        Line::from(vec![
            Span::styled(error_state_name(&controller.error_state), style),
            Span::from(format!("  TEC {}  REC {}  ", controller.tec, controller.rec)),
            Span::styled(format!("lost {}", controller.overflows), lost_style),
        ]),
        Line::from(format!(
            "frame served in {} us, worst {} us",
            us(state.latency.last),
            us(state.latency.worst)
        )),
    ];
    let Wiring { crystal_mhz, .. } = state.wiring;
    let title = format!(
        " MCP2515: {}, {}, {crystal_mhz} MHz ",
        controller.mode,
        state.wiring.shield_name()
    );
    let block = Block::bordered().title(title);
    frame.render_widget(Paragraph::new(lines).block(block), area);
}

fn draw_load(frame: &mut Frame<'_>, area: Rect, state: &State) {
    let (columns, rows) = (area.width.saturating_sub(2), area.height.saturating_sub(2));
    let lines =
        state.load_by_type.borrow_mut().lines(state.now, usize::from(columns), usize::from(rows));
    let lines: Vec<_> = lines.into_iter().map(Line::from).collect();
    let block = Block::bordered().title(" Load by node and type (l or Esc: traffic) ");
    frame.render_widget(Paragraph::new(lines).block(block), area);
}

fn draw_traffic(frame: &mut Frame<'_>, area: Rect, state: &State, screen: &Screen) {
    let rows = usize::from(area.height.saturating_sub(2));
    let lines = state.traffic.page(rows, screen.until, &screen.hidden);
    let columns = usize::from(area.width.saturating_sub(2));
    let lines: Vec<_> = lines.into_iter().map(|line| traffic_line(line, columns)).collect();
    let block = Block::bordered().title(traffic_title(state, screen, columns));
    frame.render_widget(Paragraph::new(lines).block(block), area);
}

/// The title of the traffic: names the hidden types, or counts them if the names do not fit.
fn traffic_title(state: &State, screen: &Screen, columns: usize) -> String {
    let back = match screen.until {
        Some(_) => {
            format!(
                ", {} lines back (End: newest)",
                state.traffic.newer(screen.until, &screen.hidden)
            )
        }
        None => String::new(),
    };
    let title = |hidden: &str| format!(" Traffic{hidden}{back} ");
    if screen.hidden.is_empty() {
        return title("");
    }
    let names: Vec<_> = screen.hidden.iter().map(String::as_str).collect();
    let named = title(&format!(" without {}", names.join(", ")));
    if named.chars().count() <= columns {
        named
    } else {
        title(&format!(" without {} types", names.len()))
    }
}

/// `text` in at most `columns` columns, with a mark at its end if there is more.
fn cut(text: &str, columns: usize) -> String {
    if text.chars().count() <= columns {
        return text.to_owned();
    }
    text.chars().take(columns.saturating_sub(1)).chain(['…']).collect()
}

fn traffic_line(line: &TrafficLine, columns: usize) -> Line<'static> {
    let style = match line.origin {
        Origin::Node => NODE,
        Origin::Other => Style::new(),
        Origin::Foreign => DIM,
        Origin::Broken => BAD,
    };
    let time = format!("{:10.4} ", seconds(line.at));
    let rest = cut(&line.to_string(), columns.saturating_sub(time.len()));
    Line::from(vec![Span::styled(time, DIM), Span::styled(rest, style)])
}

fn draw_serial(frame: &mut Frame<'_>, area: Rect, state: &State) {
    let rows = usize::from(area.height.saturating_sub(2));
    let columns = usize::from(area.width.saturating_sub(2));
    let line = |(_, text): &(u64, String)| Line::from(cut(text, columns));
    let lines: Vec<_> = state.serial.tail(rows, 0).map(line).collect();
    let block = Block::bordered().title(" Serial monitor ");
    frame.render_widget(Paragraph::new(lines).block(block), area);
}

/// The last line of the screen: the keys that fit.
fn foot_line(width: u16) -> Line<'static> {
    let keys = [
        ("←→", "servo"),
        ("s", "sweep"),
        ("tT", "temp"),
        ("f", "faults"),
        ("x", "end them"),
        ("/", "filter"),
        ("c", "cable"),
        ("a", "mute"),
        ("r", "reset"),
        ("p", "pause"),
        ("v", "type"),
        ("l", "load"),
        ("d", "arm"),
        ("o", "dialect"),
        ("PgUp", "scroll"),
    ];
    let last = [("Esc", "close"), ("h", "help"), ("q", "quit")];
    let length = |(key, text): &(&str, &str)| key.chars().count() + text.len() + 2;
    let mut room = usize::from(width).saturating_sub(last.iter().map(length).sum());
    let fits = keys.into_iter().take_while(|key| {
        let fits = length(key) <= room;
        room = room.saturating_sub(length(key));
        fits
    });
    let spans = fits.chain(last).flat_map(|(key, text)| {
        [Span::from(format!(" {key}")).bold(), Span::styled(format!(" {text}"), DIM)]
    });
    Line::from(spans.collect::<Vec<_>>())
}

#[cfg(test)]
#[path = "live_tests.rs"]
mod tests;
