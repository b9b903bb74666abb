//! What a shader still does once its specialisation constants are fixed, and how its structures are laid out.

use rspirv::dr::{self, Block, Instruction, Module, Operand};
use rspirv::spirv::{Decoration, Op};
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

/// A shader with fixed specialisation constants.
pub struct Specialized {
    module: Module,
    names: HashMap<u32, String>,
    values: HashMap<u32, u64>,
}

/// What is left of a shader.
#[derive(Debug, Default)]
pub struct Left {
    /// Instructions that can run.
    pub instructions: usize,
    /// Global variables that they name.
    pub variables: BTreeSet<String>,
}

fn id(operand: Option<&Operand>) -> Option<u32> {
    match operand {
        Some(Operand::IdRef(id)) => Some(*id),
        _ => None,
    }
}

fn literal(operand: Option<&Operand>) -> Option<u32> {
    match operand {
        Some(Operand::LiteralBit32(v)) => Some(*v),
        _ => None,
    }
}

/// The value of a whole-number or logical operation.
fn evaluate(op: Op, a: &[u64]) -> Option<u64> {
    let word = |v: u64| v & 0xffff_ffff;
    Some(match (op, a) {
        (Op::LogicalNot, [a]) => u64::from(*a == 0),
        (Op::LogicalAnd, [a, b]) => u64::from(*a != 0 && *b != 0),
        (Op::LogicalOr, [a, b]) => u64::from(*a != 0 || *b != 0),
        (Op::IEqual, [a, b]) => u64::from(a == b),
        (Op::INotEqual, [a, b]) => u64::from(a != b),
        (Op::UGreaterThan, [a, b]) => u64::from(a > b),
        (Op::UGreaterThanEqual, [a, b]) => u64::from(a >= b),
        (Op::ULessThan, [a, b]) => u64::from(a < b),
        (Op::ULessThanEqual, [a, b]) => u64::from(a <= b),
        (Op::Select, [c, a, b]) => {
            if *c != 0 {
                *a
            } else {
                *b
            }
        }
        (Op::IAdd, [a, b]) => word(a + b),
        (Op::ISub, [a, b]) => word(a.wrapping_sub(*b)),
        (Op::IMul, [a, b]) => word(a * b),
        (Op::UDiv, [a, b]) if *b > 0 => a / b,
        _ => return None,
    })
}

impl Specialized {
    /// Fixes the constants of these ids (`constant_id`).
    ///
    /// # Panics
    /// Where the words are no SPIR-V.
    #[allow(clippy::unwrap_used, reason = "only tests call it")]
    pub fn new(words: &[u32], constants: &[u32]) -> Self {
        let module = dr::load_words(words).unwrap();
        let mut names = HashMap::new();
        for i in module.debug_names.iter().filter(|i| i.class.opcode == Op::Name) {
            if let (Some(of), Some(Operand::LiteralString(name))) =
                (id(i.operands.first()), i.operands.get(1))
            {
                names.insert(of, name.clone());
            }
        }
        let mut made = Self { module, names, values: HashMap::new() };
        let ids: HashMap<u32, u32> =
            made.spec_ids().into_iter().map(|(constant, id, _)| (id, constant)).collect();
        for i in &made.module.types_global_values {
            let Some(result) = i.result_id else { continue };
            let fixed = ids.get(&result).and_then(|&c| constants.get(c as usize)).map(|&v| u64::from(v));
            let value = match i.class.opcode {
                Op::ConstantTrue => Some(1),
                Op::ConstantFalse => Some(0),
                Op::Constant => literal(i.operands.first()).map(u64::from),
                Op::SpecConstantTrue => fixed.or(Some(1)),
                Op::SpecConstantFalse => fixed.or(Some(0)),
                Op::SpecConstant => fixed.or(literal(i.operands.first()).map(u64::from)),
                Op::SpecConstantOp => match i.operands.first() {
                    Some(Operand::LiteralSpecConstantOpInteger(op)) => {
                        known(&made.values, &i.operands[1..]).and_then(|a| evaluate(*op, &a))
                    }
                    _ => None,
                },
                _ => None,
            };
            if let Some(value) = value {
                made.values.insert(result, value);
            }
        }
        made
    }

    /// Every specialisation constant: its `constant_id`, its SPIR-V id and its name.
    pub fn spec_ids(&self) -> Vec<(u32, u32, String)> {
        let mut list: Vec<_> = self
            .module
            .annotations
            .iter()
            .filter(|i| i.operands.get(1) == Some(&Operand::Decoration(Decoration::SpecId)))
            .filter_map(|i| {
                let of = id(i.operands.first())?;
                Some((literal(i.operands.get(2))?, of, self.names.get(&of).cloned().unwrap_or_default()))
            })
            .collect();
        list.sort();
        list
    }

    /// Byte offsets of a structure's members by name; empty where there is none of that name.
    pub fn offsets(&self, structure: &str) -> BTreeMap<String, u32> {
        let mut offsets = BTreeMap::new();
        for (&of, _) in self.names.iter().filter(|(_, name)| *name == structure) {
            for i in self.module.annotations.iter().filter(|i| id(i.operands.first()) == Some(of)) {
                if i.class.opcode == Op::MemberDecorate
                    && i.operands.get(2) == Some(&Operand::Decoration(Decoration::Offset))
                    && let (Some(member), Some(offset)) =
                        (literal(i.operands.get(1)), literal(i.operands.get(3)))
                {
                    offsets.insert(self.member(of, member), offset);
                }
            }
        }
        offsets
    }

    fn member(&self, structure: u32, member: u32) -> String {
        self.module
            .debug_names
            .iter()
            .find(|i| {
                i.class.opcode == Op::MemberName
                    && id(i.operands.first()) == Some(structure)
                    && literal(i.operands.get(1)) == Some(member)
            })
            .and_then(|i| match i.operands.get(2) {
                Some(Operand::LiteralString(name)) => Some(name.clone()),
                _ => None,
            })
            .unwrap_or_default()
    }

    /// Local size of a compute shader along x.
    pub fn local_size(&self) -> Option<u32> {
        self.module.execution_modes.iter().find_map(|i| literal(i.operands.get(2)))
    }

    /// What can run from the entry point.
    pub fn left(&self) -> Left {
        let mut left = Left::default();
        let mut seen = HashSet::new();
        let entries = self.module.entry_points.iter().filter_map(|i| id(i.operands.get(1)));
        let mut open: Vec<u32> = entries.collect();
        let globals: HashSet<u32> = self
            .module
            .types_global_values
            .iter()
            .filter(|i| i.class.opcode == Op::Variable)
            .filter_map(|i| i.result_id)
            .collect();
        while let Some(next) = open.pop() {
            if !seen.insert(next) {
                continue;
            }
            let of_id = |f: &&dr::Function| f.def.as_ref().and_then(|d| d.result_id) == Some(next);
            for block in
                self.module.functions.iter().find(of_id).map(|f| self.blocks(&f.blocks)).unwrap_or_default()
            {
                for i in &block.instructions {
                    left.instructions += 1;
                    if i.class.opcode == Op::FunctionCall {
                        open.extend(id(i.operands.first()));
                    }
                    for used in i.operands.iter().filter_map(|o| id(Some(o))).filter(|o| globals.contains(o))
                    {
                        left.variables.insert(self.names.get(&used).cloned().unwrap_or_default());
                    }
                }
            }
        }
        left
    }

    /// The blocks of a function that can be reached.
    fn blocks<'a>(&self, blocks: &'a [Block]) -> Vec<&'a Block> {
        let label = |b: &Block| b.label.as_ref().and_then(|l| l.result_id);
        let mut values = self.values.clone();
        let mut reached = HashSet::new();
        let mut open: Vec<u32> = blocks.first().and_then(label).into_iter().collect();
        let mut found = Vec::new();
        while let Some(next) = open.pop() {
            if !reached.insert(next) {
                continue;
            }
            let Some(block) = blocks.iter().find(|b| label(b) == Some(next)) else { continue };
            for i in &block.instructions {
                if let (Some(result), Some(a)) = (i.result_id, known(&values, &i.operands))
                    && let Some(value) = evaluate(i.class.opcode, &a)
                {
                    values.insert(result, value);
                }
            }
            open.extend(block.instructions.last().map(|i| targets(i, &values)).unwrap_or_default());
            found.push(block);
        }
        found
    }
}

fn known(values: &HashMap<u32, u64>, operands: &[Operand]) -> Option<Vec<u64>> {
    operands.iter().map(|o| id(Some(o)).and_then(|i| values.get(&i).copied())).collect()
}

/// Where a block can go on.
fn targets(last: &Instruction, values: &HashMap<u32, u64>) -> Vec<u32> {
    let labels: Vec<u32> = last.operands.iter().filter_map(|o| id(Some(o))).collect();
    let value = labels.first().and_then(|c| values.get(c));
    match (last.class.opcode, value) {
        (Op::Branch, _) => labels,
        (Op::BranchConditional, Some(&v)) => vec![labels[if v != 0 { 1 } else { 2 }]],
        (Op::BranchConditional | Op::Switch, _) => labels[1..].to_vec(),
        _ => Vec::new(),
    }
}
